//! Model files with every array that they refer to.
//!
//! Input: a path or the name of a shipped model. Output: a [`Network`]. A problem with an array's
//! file is reported at the place in the model file that names the array. `nsim_files::lower` checks
//! the numbers.

use std::collections::BTreeMap;
use std::path::Path;

use super::foreign;
use super::foreign::Reading;
use nsim_files::network::{ArrayRef, Network, NetworkFile, place};
use nsim_files::shipped;
use nsim_files::shipped::Origin;
use nsim_files::text::sibling_path;
use nsim_files::warnings::show;
use nsim_files::{changes, npy, safetensors};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::tensor::Tensor;

/// Loads a model: a path, `-`, or a shipped name. A file of another tool is imported like by `nsim
/// import` without options.
///
/// # Errors
/// `model.unknown`, `model.syntax`, `io.*`; for arrays, their own codes at the place that names
/// them.
pub fn load_model(argument: &str) -> Result<Network> {
    load_model_with(argument, &Reading::default())
}

/// As [`load_model`], with facts that the file of another tool does not state. Warns of
/// assumptions about such a file.
///
/// # Errors
/// As [`load_model`]; `model.timestep` and `import.option` for a model file that contradicts them.
pub fn load_model_with(argument: &str, reading: &Reading) -> Result<Network> {
    let path = Path::new(argument);
    if shipped::is_path(argument) && foreign::is_foreign(path) {
        let network = foreign::network(path, &foreign::Options { reading: *reading, ..Default::default() })?;
        show(argument, &network.conventions().warnings);
        return Ok(network);
    }
    let (source, origin) = shipped::path_or_shipped_text(argument, shipped::MODELS, "model", "model.unknown")?;
    check_reading(network(source, origin)?, reading)
}

/// Returns the model of a file of nsim's own if no given fact contradicts it.
///
/// # Errors
/// `model.timestep`; `import.option` for a tool or a reset.
pub fn check_reading(network: Network, reading: &Reading) -> Result<Network> {
    let own = network.file().timestep_ms;
    let of_others = [("--from", reading.tool.is_some()), ("--reset", reading.reset.is_some())];
    if let Some((option, _)) = of_others.iter().find(|(_, given)| *given) {
        let message = format!("the model is a file of nsim's own, to which {option} does not apply");
        return Err(Diagnostic::new("import.option", message)
            .at(network.source(), place(network.source(), "name"))
            .help(format!("leave {option} out: the model states its neurons")));
    }
    let Some(dt) = reading.dt_ms.filter(|dt| (dt / own - 1.0).abs() > 1e-9) else { return Ok(network) };
    let message = format!("the model has a timestep of {own} ms, which --dt {dt} contradicts");
    Err(Diagnostic::new("model.timestep", message)
        .at(network.source(), place(network.source(), "timestep_ms"))
        .help(format!("leave --dt out, or change the model: --set timestep_ms={dt}")))
}

/// Loads a model from its text; its arrays are in the folder of `source`, or shipped.
/// Errors are those of [`load_model`].
pub fn network(source: SourceText, origin: Origin) -> Result<Network> {
    parse_network(changes::model(source)?, origin)
}

/// Loads a model from its text, after all changes.
fn parse_network(source: SourceText, origin: Origin) -> Result<Network> {
    let file = NetworkFile::parse(&source)?;
    let arrays = read_arrays(&source, origin, &file)?;
    Network::new(file, source, arrays)
}

/// A model that is read once, to which many changes are applied.
#[derive(Debug)]
pub struct BaseModel {
    network: Network,
    origin: Origin,
}

impl BaseModel {
    /// Reads a model; `None` when it is another tool's, or invalid without changes.
    pub fn load(argument: &str) -> Option<Self> {
        let path = Path::new(argument);
        if shipped::is_path(argument) && foreign::is_foreign(path) {
            return None;
        }
        let (source, origin) =
            shipped::path_or_shipped_text(argument, shipped::MODELS, "model", "model.unknown").ok()?;
        Some(BaseModel { network: parse_network(source, origin).ok()?, origin })
    }

    /// Number of elements in its arrays.
    pub fn element_count(&self) -> u64 {
        self.network.file().arrays().iter().map(|(reference, _)| self.network.array(reference).len() as u64).sum()
    }

    /// The model that [`load_model`] would read under the current changes of the process and of the
    /// thread. Errors are those of [`load_model`].
    pub fn with_changes(&self) -> Result<Network> {
        let source = changes::model(self.network.source().clone())?;
        let file = NetworkFile::parse(&source)?;
        match self.network.with_file(file, source.clone()) {
            Some(network) => Ok(network),
            None => parse_network(source, self.origin),
        }
    }
}

fn read_arrays(source: &SourceText, origin: Origin, file: &NetworkFile) -> Result<BTreeMap<ArrayRef, Tensor>> {
    let mut arrays = BTreeMap::new();
    // A safetensors file often has all layers, so it is read once.
    let mut opened: BTreeMap<String, safetensors::TensorFile> = BTreeMap::new();
    for (reference, path) in file.arrays() {
        if arrays.contains_key(&reference) {
            continue;
        }
        let mut read = || match &reference {
            ArrayRef::Npy(name) => open_array(source, origin, name, npy::open, npy::Array::from_bytes)?.tensor(),
            ArrayRef::Safetensors(name, key) => {
                if !opened.contains_key(name.as_str()) {
                    let file =
                        open_array(source, origin, name, safetensors::open, safetensors::TensorFile::from_bytes)?;
                    opened.insert(name.clone(), file);
                }
                opened[name.as_str()].tensor(key)
            }
        };
        let tensor = read().map_err(|problem| point_at(source, &path, &reference, problem))?;
        arrays.insert(reference, tensor);
    }
    Ok(arrays)
}

fn open_array<T>(
    source: &SourceText,
    origin: Origin,
    name: &str,
    open: impl Fn(&Path) -> Result<T>,
    from_bytes: impl Fn(&Path, Vec<u8>) -> Result<T>,
) -> Result<T> {
    match origin {
        Origin::File => open(&sibling_path(source.path(), name)),
        Origin::Shipped => match shipped::ARRAYS.iter().find(|(path, _)| *path == name) {
            Some((path, bytes)) => from_bytes(Path::new(path), bytes.to_vec()),
            None => Err(Diagnostic::new("io.missing", "this array is not shipped")),
        },
    }
}

/// The problem with an array's file, reported at its place in the model.
fn point_at(source: &SourceText, path: &str, array: &ArrayRef, mut problem: Diagnostic) -> Diagnostic {
    let (ArrayRef::Npy(name) | ArrayRef::Safetensors(name, _)) = array;
    let file = problem.file().map_or_else(|| name.clone(), |file| file.display().to_string());
    problem.message = format!("{file}: {}", problem.message);
    problem.at(source, place(source, path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_files::network::{Parameter, ProjectionKind, Source, Weights};
    use nsim_ir::tensor::Numbers;

    const EVERYTHING: &str = r#"// A comment.
#![enable(implicit_some)]
Network(
    name: "all", /* nested /* comment */ */
    timestep_ms: 1.0,
    populations: [
        Input(name: "µ-in", shape: [2, 3, 3]),
        Loihi(name: "a", shape: [2], du: 1024, dv: [128, 256], vth_mant: Npy("v.npy"), refractory: 1,),
        Loihi(name: "b", shape: [2], tau_u_ms: 3.5, tau_v_ms: Uniform(low: 1, high: 2.5, seed: 7), vth: 1, bias: -0.5),
    ],
    projections: [
        Dense(from: ["µ-in"], to: "a", weights: Safetensors("w.safetensors", "fc.weight"), sign: Mixed, weight_exp: -1),
        Dense(from: ["a"], to: "b", weights: [[2, -4], [6.0, 8e0]], sign: Excitatory, weight_bits: 8, delay: 3),
        Sparse(from: ["a"], to: "b", synapses: [(0, 1, 2), (1, 0, -2.5)], weight_scale: 2.0),
        Conv2d(from: ["µ-in"], to: "a", weights: [[[[1]], [[2]]]], stride: (2, 2), padding: (0, 1)),
        SumPool2d(from: ["µ-in"], to: "a", kernel: (3, 3), weight: 1),
        Random(from: ["a"], to: "b", fan_out: 2, low: -4, high: 4, seed: 0),
    ],
    output: "b",
    classes: ["x", "y"],
    reset: (interval: 10),
    threshold: Inclusive,
    semantics: Lava,
    weight_rounding: Floor,
    scene: "scene:slip?seed=1",
    provenance: "made by hand",
)
"#;

    fn write(folder: &tempfile::TempDir, name: &str, numbers: &[i32]) {
        let file = std::fs::File::create(folder.path().join(name)).unwrap();
        npy::write(file, &[numbers.len() as u64], numbers.iter().copied()).unwrap();
    }

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "v.npy", &[80, 90]);
        let json = r#"{"fc.weight":{"dtype":"I8","shape":[2,18],"data_offsets":[0,36]}}"#;
        let mut bytes = (json.len() as u64).to_le_bytes().to_vec();
        bytes.extend(json.bytes());
        bytes.extend([2; 36]);
        std::fs::write(folder.path().join("w.safetensors"), bytes).unwrap();
        folder
    }

    fn load(folder: &tempfile::TempDir, text: &str) -> Result<Network> {
        let path = folder.path().join("m.ron");
        std::fs::write(&path, text).unwrap();
        load_model(path.to_str().unwrap())
    }

    #[test]
    fn every_kind_of_value_is_read_and_its_place_is_found() {
        let folder = folder();
        let network = load(&folder, EVERYTHING).unwrap();
        let file = network.file();
        let text_at = |path: &str| {
            let span = place(network.source(), path);
            &network.source().text()[span.start..span.end]
        };
        assert_eq!((file.populations[0].name.as_str(), text_at("populations.[0].name")), ("µ-in", "\"µ-in\""));
        let (a, b) = (&file.populations[1], &file.populations[2]);
        assert_eq!((a.parameter("du"), text_at("populations.a.du")), (Some(&Parameter::Same(1024.0)), "1024"));
        assert_eq!(a.parameter("dv"), Some(&Parameter::Each(vec![128.0, 256.0])));
        let Some(Parameter::From(source)) = a.parameter("vth_mant") else { panic!() };
        assert_eq!(network.array(&source.array().unwrap()).numbers(), &Numbers::Integers(vec![80, 90]));
        let uniform = Source::Uniform { low: 1.0, high: 2.5, step: None, seed: 7 };
        assert_eq!(b.parameter("tau_v_ms"), Some(&Parameter::From(uniform)));
        assert_eq!(text_at("populations.b.tau_v_ms"), "Uniform(low: 1, high: 2.5, seed: 7)");
        let weights = |index: usize| network.tensor(file.projections[index].weights().unwrap()).unwrap();
        assert_eq!(weights(0).shape(), [2, 18]);
        assert_eq!((file.projections[0].weight_exp, text_at("projections.[0].weight_exp")), (Some(-1), "-1"));
        assert_eq!((weights(1).shape(), text_at("projections.[1].weights.[1]")), (&[2, 2][..], "[6.0, 8e0]"));
        assert_eq!(file.projections[2].kind, ProjectionKind::Sparse(vec![(0, 1, 2.0), (1, 0, -2.5)]));
        let ProjectionKind::Conv2d { weights: Weights::InPlace(kernel), stride, padding_after, .. } =
            &file.projections[3].kind
        else {
            panic!()
        };
        assert_eq!((kernel.shape(), *stride, *padding_after), (&[1, 2, 1, 1][..], (2, 2), (0, 1)));
    }

    /// A network of three inputs and two compartments with these fields for its synapses.
    fn listed(way: &str) -> String {
        format!(
            "Network(name: \"t\", timestep_ms: 1.0, populations: [Input(name: \"a\", shape: [2]), Input(name: \"b\", \
             shape: [1]), Loihi(name: \"o\", shape: [2], du: 1024, dv: 128, vth_mant: 80)],\n projections: \
             [Sparse(from: [\"a\", \"b\"], to: \"o\", {way})], output: \"o\")"
        )
    }

    #[test]
    fn synapses_in_arrays_are_those_listed_in_place() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "s.npy", &[0, 0, 1, 2]);
        write(&folder, "f.npy", &[0, 2, 3, 4]);
        write(&folder, "t.npy", &[1, 0, 1, 1]);
        write(&folder, "w.npy", &[4, -2, 6, 8]);
        write(&folder, "d.npy", &[0, 3, 3, 0]);
        let lowered = |way: &str| load(&folder, &listed(way))?.resolved();
        let in_place = lowered("synapses: [(0, 1, 4), (0, 0, -2), (1, 1, 6), (2, 1, 8)]").unwrap();
        let files = r#"target: Npy("t.npy"), weight: Npy("w.npy")"#;
        for from in [r#"source: Npy("s.npy")"#, r#"first: Npy("f.npy")"#] {
            let arrays = lowered(&format!("arrays: ({from}, {files})")).unwrap();
            assert_eq!(arrays.projections, in_place.projections, "{from}");
        }
        let delayed = lowered(&format!(r#"arrays: (source: Npy("s.npy"), {files}, delay: Npy("d.npy"))"#)).unwrap();
        let found: Vec<_> = delayed.projections.iter().map(|p| (p.delay, p.kind.clone())).collect();
        let sparse = |synapses: &[(u64, u64, f64)]| ProjectionKind::Sparse(synapses.to_vec());
        assert_eq!(found, [(0, sparse(&[(0, 1, 4.0), (2, 1, 8.0)])), (3, sparse(&[(0, 0, -2.0), (1, 1, 6.0)]))]);
    }

    #[test]
    fn arrays_of_synapses_that_do_not_match_are_refused_where_they_are_named() {
        let folder = tempfile::tempdir().unwrap();
        for (name, numbers) in
            [("two.npy", &[0, 1][..]), ("three.npy", &[0, 1, 2]), ("far.npy", &[0, 5]), ("back.npy", &[0, 2, 1, 2])]
        {
            write(&folder, name, numbers);
        }
        let [two, three, far, back] = ["two", "three", "far", "back"].map(|name| format!("Npy(\"{name}.npy\")"));
        for (way, code, word) in [
            (format!("target: {two}, weight: {two}"), "model.synapse-arrays", "both source and first are missing"),
            (format!("source: {two}, first: {two}, target: {two}, weight: {two}"), "model.synapse-arrays", "both"),
            (format!("source: {two}, target: {two}, weight: {three}"), "model.synapse-arrays", "3 numbers"),
            (format!("source: {two}, target: {far}, weight: {two}"), "model.synapse-index", "entry 1: target 5"),
            (format!("first: {three}, target: {two}, weight: {two}"), "model.synapse-arrays", "3 numbers for 3"),
            (format!("first: {back}, target: {two}, weight: {two}"), "model.synapse-arrays", "does not ascend"),
        ] {
            let network = load(&folder, &listed(&format!("arrays: ({way})"))).unwrap();
            let error = network.resolved().unwrap_err();
            assert_eq!(error.code, code, "{way}: {error}");
            assert!(error.message.contains(word) && error.position().is_some(), "{way}: {error}");
        }
    }
}
