//! The kinds of neurons of Loihi 2 against recordings of lava and lava-dl, and both engines
//! compared on networks of mixed kinds, messages and ports.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::compare::{assert_on_machine, roomy, small_cores, trace};
use crate::common::random::{self, Draw};
use crate::common::{Array, Builder, data, engines, format, unsearched};
use nsim::compile::{CompileError, Options, compile};
use nsim::dynamics;
use nsim::files::network::Network;
use nsim::files::shipped::Origin;
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::import::{foreign, model};
use nsim::ir::activity::Overflow;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::base::fixed::{MessageBits, Payload, SignMode};
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::graph::Shape;
use nsim::ir::hardware::Chip;
use nsim::ir::neurons::{Emits, NeuronKind, Port};
use nsim::ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim::ir::quantised::{Neuron, Quantised, Units};
use nsim::ir::spikes::{Engine, Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::session::front::front;
use nsim_testing::kinds::{own, stated};
use nsim_testing::{cases, sparse};
use rayon::prelude::*;
use serde_json::Value;

/// Neurons of a kind, each with its own inputs, unweighted.
fn alone(kind: NeuronKind, rows: &[Vec<i64>]) -> Quantised {
    let mut net = Builder::new();
    let count = rows.len() as u32;
    let neurons: Vec<Neuron> = rows.iter().map(|row| dynamics::neuron(kind, row).unwrap()).collect();
    let inputs: Vec<_> = (0..kind.table().ports).map(|port| net.input(&format!("in{port}"), count)).collect();
    let target = net.each("target", Shape::Line(count), &neurons, 0);
    for (input, port) in inputs.into_iter().zip([Port::First, Port::Second]) {
        let own = sparse((0..count).map(|unit| vec![(unit, 1)]));
        net.connect(input, target, SynapseFormat { port, ..format(SignMode::Excitatory, 0) }, 0, own);
    }
    for population in net.parts.populations.iter_mut() {
        let values = matches!(population.units, Units::Input(_)) || kind.table().emits == Emits::Values;
        population.message = if values { Message::Value(MessageBits::MAX) } else { Message::Spike };
    }
    net.build()
}

/// A sample of the inputs `[neuron][step]` of each port.
fn shown(inputs: &[Array]) -> Sample {
    let (count, steps) = (inputs[0].shape[0], inputs[0].shape[1]);
    let mut events = Vec::new();
    for (port, input) in inputs.iter().enumerate() {
        for (at, &value) in input.values.iter().enumerate() {
            events.push(((at % steps) as u32, ChannelId((port * count + at / steps) as u32), value as i32));
        }
    }
    Sample::with_values(steps as u32, &events, None).unwrap()
}

/// Files of a recording: inputs by port, messages, and words of state in the kind's order.
#[derive(Clone, Copy)]
struct Files {
    ports: &'static [&'static str],
    out: &'static str,
    columns: &'static [&'static str],
}

const ONE: &[&str] = &["a_in"];
const COMPLEX: &[&str] = &["a_real_in", "a_imag_in"];
const TWO: &[&str] = &["a_in1", "a_in2"];

const fn files(ports: &'static [&'static str], columns: &'static [&'static str]) -> Files {
    Files { ports, out: "s_out", columns }
}

/// Recorded value of a word of state, from the words after the step and whether a message was sent.
/// `None` if the recording has nothing that is stored.
type Shown = fn(words: &[i64], column: usize, row: &[i64], sent: bool) -> Option<i64>;

/// Recordings of the words after the step.
const AFTER: Shown = |words, column, _, _| Some(words[column]);
/// Recordings of the words before a reset.
const BEFORE_RESET: Shown = |words, column, _, sent| (!sent).then_some(words[column]);
/// Recordings of the threshold (`words[2]`) and the refractory state (`words[3]`) before a spike
/// raises them. Column 5 of a row is the step of the threshold.
const BEFORE_RAISE: Shown = |words, column, row, sent| {
    let theta = words[2] - if sent { row[5] } else { 0 };
    Some(match column {
        2 => theta,
        3 if sent => words[3] - 2 * theta,
        _ => words[column],
    })
};

/// Compares every engine with recorded messages and words of state; returns the number of compared
/// numbers.
fn matches_recording(folder: &Path, kind: NeuronKind, rows: &[Vec<i64>], files: Files, shown_as: Shown) -> u64 {
    let read = |name: &&str| Array::read(&folder.join(format!("{name}.npy")));
    let sample = shown(&files.ports.iter().map(read).collect::<Vec<_>>());
    let expected = read(&files.out);
    let states: Vec<Array> = files.columns.iter().map(read).collect();
    let (mut compared, steps) = (0, sample.steps());
    let networks = [kind, stated(kind)].map(|kind| alone(kind, rows));
    for (name, mut engine) in networks.iter().flat_map(engines) {
        engine.begin(steps);
        for step in 0..steps {
            engine.step(sample.input(step));
            let at = |array: &Array, n: usize| array.at([n, step as usize]);
            for (n, row) in rows.iter().enumerate() {
                let id = CompartmentId(n as u32);
                let sent = engine.spikes().iter().position(|spike| *spike == id);
                let message = sent.map_or(0, |place| engine.payloads().get(place).copied().unwrap_or(1));
                assert_eq!(i64::from(message), at(&expected, n), "{name}, {}, {n}, step {step}", folder.display());
                let words: Vec<i64> = (0..states.len()).map(|column| engine.state(id, column).into()).collect();
                for (column, state) in states.iter().enumerate() {
                    let Some(word) = shown_as(&words, column, row, sent.is_some()) else { continue };
                    assert_eq!(word, at(state, n), "{name}, {}, {n}, column {column}, step {step}", folder.display());
                    compared += 1;
                }
                compared += 1;
            }
        }
    }
    compared
}

fn parameters(folder: &Path) -> serde_json::Map<String, Value> {
    let text = std::fs::read_to_string(folder.join("parameters.json")).unwrap();
    serde_json::from_str::<Value>(&text).unwrap().as_object().unwrap().clone()
}

/// Regimes of products wrapped to 32 bits by the tool, which nsim computes exactly.
const FAULTS_OF_THE_TOOL: [&str; 3] = ["int_delta_32bit_product", "int32_product_wraps", "product_wraps_32"];

/// lava's processes, in every regime without a fault of the tool.
#[test]
fn recorded_neurons_of_lava_match_bit_for_bit() {
    use NeuronKind::*;
    let Some(folder) = data("loihi2/neuron") else { return };
    let square = Files { ports: &["a_in1"], out: "s2_out", columns: &[] };
    let mut compared = 0;
    for (name, kind, files) in [
        ("SigmaDelta", SigmaDelta, files(ONE, &["sigma", "act", "residue", "error"])),
        ("SigmaDeltaCorrected", SigmaDelta, files(ONE, &["sigma", "act"])),
        ("Delta", Delta, files(ONE, &["act", "residue", "error"])),
        ("Sigma", Sigma, files(ONE, &["sigma"])),
        ("RF", Rf, files(COMPLEX, &["real", "imag"])),
        ("RF_IZ", RfIz, files(COMPLEX, &["real", "imag"])),
        ("TernaryLIF", TernaryLif, files(ONE, &["u", "v"])),
        ("LIFReset", LifReset, files(ONE, &["u", "v"])),
        ("ATRLIF", AtrLif, files(ONE, &["i", "v", "theta", "r"])),
        ("RFZero", RfZero, files(&["u_in", "v_in"], &["u", "v"])),
        ("GradedVec", GradedVec, files(ONE, &[])),
        ("GradedReluVec", GradedReluVec, files(ONE, &[])),
        ("ProdNeuron", ProdNeuron, files(TWO, &[])),
        ("NormVecDelay", NormVecDelay, files(TWO, &["v", "v2"])),
        ("NormVecDelay", NormSquare, square),
        ("InvSqrt", InvSqrt, files(ONE, &[])),
    ] {
        for (regime, given) in parameters(&folder.join(name)) {
            if FAULTS_OF_THE_TOOL.contains(&regime.as_str()) {
                continue;
            }
            // The file has one number for all neurons, or one each.
            let of = |n: usize, key: &str| {
                let value = given[key].as_array().map_or(&given[key], |each| &each[n]);
                value.as_i64().unwrap_or_else(|| i64::from(*value == Value::Bool(true)))
            };
            let row = |n: usize| -> Vec<i64> {
                let all = |keys: &[&str]| keys.iter().map(|key| of(n, key)).collect::<Vec<_>>();
                match kind {
                    SigmaDelta => {
                        let [relu, corrected] =
                            [given["act_mode"] == "RELU", name.ends_with("Corrected")].map(i64::from);
                        let [before, cum_error] =
                            [all(&["vth", "bias", "spike_exp", "state_exp"]), all(&["cum_error"])];
                        [before, vec![relu], cum_error, vec![corrected]].concat()
                    }
                    Delta => all(&["vth", "spike_exp", "state_exp", "cum_error"]),
                    Rf | RfIz => all(&["sin_decay_int", "cos_decay_int", "vth_scaled", "state_exp", "decay_bits"]),
                    TernaryLif => {
                        let rest = all(&["dv", "vth_hi", "vth_lo", "bias_mant", "bias_exp"]);
                        [vec![of(n, "du") + 1], rest].concat()
                    }
                    LifReset => {
                        let rest = all(&["dv", "vth", "bias_mant", "bias_exp", "reset_interval", "reset_offset"]);
                        [vec![of(n, "du") + 1], rest].concat()
                    }
                    AtrLif => {
                        let decays = all(&["delta_v_4096", "delta_theta_4096", "delta_r_4096"]);
                        let rest = all(&["theta_0_scaled", "theta_step_scaled", "bias_mant", "bias_exp"]);
                        [vec![of(n, "delta_i_4096") + 1], decays, rest].concat()
                    }
                    RfZero => all(&["lst", "lct", "uth"]),
                    GradedVec | GradedReluVec | NormVecDelay => all(&["vth"]),
                    ProdNeuron => all(&["vth", "exp"]),
                    _ => Vec::new(),
                }
            };
            let folder = folder.join(name).join(&regime);
            let neurons = Array::read(&folder.join(format!("{}.npy", files.ports[0]))).shape[0];
            let rows: Vec<_> = (0..neurons).map(row).collect();
            compared += matches_recording(&folder, kind, &rows, files, AFTER);
        }
    }
    assert!(compared > 600_000, "{compared} numbers");
}

/// lava's encoder of the host, as stated by a model file.
#[test]
fn a_recorded_delta_encoder_matches_bit_for_bit() {
    let Some(folder) = data("loihi2/neuron/DeltaEncoder") else { return };
    let mut compared = 0;
    for (regime, given) in parameters(&folder) {
        let of = |key: &str| given[key].as_i64().unwrap();
        let limits = match given["num_bits"].is_null() {
            true => [i32::MIN, i32::MAX].map(i64::from),
            false => [of("a_min"), of("a_max")],
        };
        let row = [vec![of("vth"), of("spike_exp")], limits.to_vec()].concat();
        let files = files(ONE, &["act", "residue"]);
        compared += matches_recording(&folder.join(regime), own("DeltaEncoder").unwrap(), &vec![row; 8], files, AFTER);
    }
    assert!(compared > 10_000, "{compared} numbers");
}

/// lava-dl's neurons in integers.
#[test]
fn recorded_neurons_of_lava_dl_match_bit_for_bit() {
    use NeuronKind::*;
    let Some(folder) = data("loihi2/slayer") else { return };
    const ADAPTIVE: &[&str] = &["real", "imag", "threshold", "refractory"];
    let mut compared = 0;
    for (name, kind, files, shown_as) in [
        ("RF_PHASE", Rf, files(COMPLEX, &["real", "imag"]), AFTER),
        ("RF_IZ", RfIz, files(COMPLEX, &["real", "imag"]), BEFORE_RESET),
        ("ADRF", Adrf, files(COMPLEX, ADAPTIVE), BEFORE_RAISE),
        ("ADRF_IZ", AdrfIz, files(COMPLEX, ADAPTIVE), BEFORE_RAISE),
        ("ALIF", Alif, files(ONE, &["u", "v", "threshold", "refractory"]), BEFORE_RAISE),
        ("CUBA", Loihi, files(ONE, &["u", "v"]), BEFORE_RESET),
        ("CUBA", GradedLif, Files { out: "s_msg", ..files(ONE, &["u", "v"]) }, BEFORE_RESET),
        ("SDNN", SigmaDelta, Files { out: "s_msg", ..files(ONE, &[]) }, AFTER),
    ] {
        for (regime, given) in parameters(&folder.join(name)) {
            let of = |key: &str| given[key].as_i64().unwrap();
            let graded = given["gradedSpike"] == Value::Bool(true);
            if name == "CUBA" && graded != (kind == GradedLif) {
                continue;
            }
            let row = |n: usize| match kind {
                Rf | RfIz => vec![of("sinDecay"), of("cosDecay"), of("vThMant") * 64, 6, 12],
                Adrf | AdrfIz => {
                    let [threshold, step] = ["vThMant", "vThStep"].map(|key| of(key) * 64);
                    vec![of("sinDecay"), of("cosDecay"), of("thDecay"), of("refDecay"), threshold, step, 6]
                }
                Alif => {
                    let [threshold, step] = ["vThMant", "vThStep"].map(|key| of(key) * 64);
                    vec![of("iDecay"), of("vDecay"), of("thDecay"), of("refDecay"), threshold, step]
                }
                Loihi => vec![of("iDecay"), of("vDecay"), of("vThMant"), 0, 0, 1, 23, 7],
                GradedLif => vec![of("iDecay"), of("vDecay"), of("vThMant")],
                // Messages have the unit of the state; thresholds and biases have 64 of it.
                _ => {
                    let bias = &given["bias_64ths"];
                    let bias = bias.as_array().map_or(bias, |each| &each[n]).as_i64().unwrap_or(0);
                    vec![of("vThMant"), bias, 6, 0, i64::from(given["activation"] == "relu"), 0, 0]
                }
            };
            let rows: Vec<_> = (0..8).map(row).collect();
            compared += matches_recording(&folder.join(name).join(regime), kind, &rows, files, shown_as);
        }
    }
    assert!(compared > 50_000, "{compared} numbers");
}

/// Resonators of lava-dl's recorded networks: driven directly, and after two matrices.
#[test]
fn recorded_layers_of_resonators_match_bit_for_bit() {
    let Some(folder) = data("loihi2/rf_blocks") else { return };
    let read = |name: &str| Array::read(&folder.join(format!("{name}.npy")));
    let [input, direct, behind] = ["s_in", "rf_iz_out", "rf_out"].map(read);
    let [real, imag] = ["weight_real", "weight_imag"].map(read);
    let steps = input.shape[1];
    let mut net = Builder::new();
    let neurons = |kind, row: &[i64], count| vec![dynamics::neuron(kind, row).unwrap(); count];
    let source = net.input("source", 200);
    let mut own = net.each("direct", Shape::Line(200), &neurons(NeuronKind::RfIz, &[3042, 2426, 70, 6, 12], 200), 0);
    for port in [Port::First, Port::Second] {
        let one = sparse((0..200).map(|unit| vec![(unit, 1)]));
        net.connect(source, own, SynapseFormat { port, ..format(SignMode::Excitatory, 0) }, 0, one);
    }
    own = net.each("behind", Shape::Line(256), &neurons(NeuronKind::Rf, &[2103, 3273, 1600, 6, 12], 256), 0);
    for (port, weights) in [(Port::First, &real), (Port::Second, &imag)] {
        let by_source = (0..200).flat_map(|s| (0..256).map(move |t| weights.at([t, s]) as i16)).collect();
        // Entry t of the input is sent in step t and arrives a step later.
        let dense = Connectivity::Dense { targets: 256, weights: by_source };
        net.connect(source, own, SynapseFormat { port, ..format(SignMode::Mixed, 0) }, 1, dense);
    }
    let events: Vec<_> = (0..input.values.len())
        .filter(|&at| input.values[at] != 0)
        .map(|at| ((at % steps) as u32, ChannelId((at / steps) as u32)))
        .collect();
    let sample = Sample::new(steps as u32, &events, None).unwrap();
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(steps as u32);
        for step in 0..steps {
            engine.step(sample.input(step as u32));
            let mut spiked = [0; 456];
            engine.spikes().iter().for_each(|spike| spiked[spike.0 as usize] = 1);
            for (n, spiked) in spiked.into_iter().enumerate() {
                let expected = if n < 200 { direct.at([n, step]) } else { behind.at([n - 200, step]) };
                assert_eq!(spiked, expected, "{name}, {n}, step {step}");
            }
        }
    }
}

/// A model file with a source that sends its inputs and a target that sends its sums.
fn connection(source: &str, target: &str, bits: i64, projections: &[String]) -> String {
    format!(
        "Network(name: \"connection\", timestep_ms: 1.0, output: \"target\", target: \"oheo-gulch\", populations: [
            Input(name: \"in\", shape: {source}, message_bits: 32),
            GradedVec(name: \"source\", shape: {source}, threshold: 0, message_bits: {bits}),
            GradedVec(name: \"target\", shape: {target}, threshold: 0)],
        projections: [{}])",
        projections.join(", ")
    )
}

/// Synapses of one delay.
fn listed((from, to): (&str, &str), synapses: &[(usize, usize, i64)], rest: &str) -> String {
    format!("Sparse(from: [\"{from}\"], to: \"{to}\", synapses: {synapses:?}, {rest})")
}

/// Weights of any sign, parity and size up to 15 bits. Each projection has one sign (`sign` with
/// its mode), and the low seven bits of the weights or, shifted, the others.
const PARTS: [(i64, &str, i64); 4] =
    [(1, "Excitatory", 0), (1, "Excitatory", 7), (-1, "Inhibitory", 0), (-1, "Inhibitory", 7)];

/// The part of a weight in a projection of [`PARTS`].
fn part_of(weight: i64, (sign, _, exponent): (i64, &str, i64)) -> i64 {
    let magnitude = if weight.signum() == sign { weight.abs() } else { 0 };
    sign * if exponent == 0 { magnitude % 128 } else { magnitude / 128 }
}

fn by_parts(synapses: &[(usize, usize, i64)], delay: usize) -> Vec<String> {
    let of_part = |part: (i64, &str, i64)| {
        let own: Vec<_> = synapses.iter().map(|&(from, to, weight)| (from, to, part_of(weight, part))).collect();
        listed(("source", "target"), &own, &format!("sign: {}, weight_exp: {}, delay: {delay}", part.1, part.2))
    };
    PARTS.into_iter().map(of_part).collect()
}

fn quantised(text: String) -> Result<Quantised, String> {
    let network = model::network(SourceText::new("connection.ron", text), Origin::File).unwrap();
    front(&network).map(nsim::compile::Front::into_quantised).map_err(|problem| problem.to_string())
}

/// Compares the sums of every engine with recorded ones; unit n of a recording is unit `place(n)`
/// of the network. Returns whether sums wrapped.
fn sums_match(what: &str, text: String, input: &Array, sums: &Array, places: [&dyn Fn(usize) -> usize; 2]) -> bool {
    let network = quantised(text).unwrap();
    let steps = *sums.shape.last().unwrap();
    let units = input.values.len() / steps;
    let mut events = Vec::new();
    for (at, &value) in input.values.iter().enumerate().filter(|(_, value)| **value != 0) {
        events.push(((at % steps) as u32, ChannelId(places[0](at / steps) as u32), value as i32));
    }
    let sample = Sample::with_values(steps as u32, &events, None).unwrap();
    let (mut not_zero, mut wrapped) = (0, Vec::new());
    for (name, mut engine) in engines(&network) {
        engine.begin(steps as u32);
        for step in 0..steps {
            engine.step(sample.input(step as u32));
            let sent: BTreeMap<usize, i64> = engine
                .spikes()
                .iter()
                .map(|id| id.0 as usize)
                .zip(engine.payloads().iter().map(|&m| m.into()))
                .collect();
            for n in 0..sums.values.len() / steps {
                let sum = sent.get(&(units + places[1](n))).copied().unwrap_or(0);
                assert_eq!(sum, sums.values[n * steps + step], "{what}, {name}, {n}, step {step}");
                not_zero += u32::from(sum != 0);
            }
        }
        wrapped.push(engine.overflow().q_wrapped);
    }
    assert!(not_zero > 100, "{what}: {not_zero}");
    assert!(wrapped.iter().all(|count| *count == wrapped[0]), "{what}: {wrapped:?}");
    wrapped[0] > 0
}

/// lava's Dense and Sparse, with delays and without, and its convolutions in space and in time.
#[test]
fn recorded_connections_of_lava_match_bit_for_bit() {
    let Some(folder) = data("loihi2/connection") else { return };
    let own = |n: usize| listed(("in", "source"), &(0..n).map(|n| (n, n, 1)).collect::<Vec<_>>(), "sign: Excitatory");
    let id: &dyn Fn(usize) -> usize = &|n| n;
    let mut regimes = 0;
    for name in ["Dense", "DelayDense", "ConvInTime", "Conv"] {
        for (regime, given) in parameters(&folder.join(name)) {
            let read = |file: &str| Array::read(&folder.join(name).join(&regime).join(format!("{file}.npy")));
            let (input, sums) = (read("s_in"), read("a_out"));
            let number = |key: &str| given[key].as_i64().unwrap_or(0);
            let bits = if number("num_message_bits") == 0 { 0 } else { 32 };
            let what = format!("{name} {regime}");
            regimes += 1;
            if name == "Conv" {
                let weights = read("weight");
                let (i, o) = (&input.shape, &sums.shape);
                let [out, kx, ky, channels] = weights.shape[..] else { panic!("{:?}", weights.shape) };
                // Recordings have [x, y, channel] and a flipped kernel, models [channel, x, y].
                let kernel = |part: (i64, &str, i64)| {
                    let weight = |o, c, x, y| weights.at([o, kx - 1 - x, ky - 1 - y, c]);
                    let row = |o, c, x| (0..ky).map(|y| part_of(weight(o, c, x, y), part)).collect::<Vec<_>>();
                    let plane = |o, c| (0..kx).map(|x| row(o, c, x)).collect::<Vec<_>>();
                    (0..out).map(|o| (0..channels).map(|c| plane(o, c)).collect()).collect::<Vec<Vec<_>>>()
                };
                let pair = |key: &str| (given[key][0].as_u64().unwrap(), given[key][1].as_u64().unwrap());
                let window = |part: (i64, &str, i64)| {
                    let [stride, padding, dilation] = ["stride", "padding", "dilation"].map(pair);
                    let groups = given["groups"].as_u64().unwrap();
                    format!(
                        "Conv2d(from: [\"source\"], to: \"target\", weights: {:?}, sign: {}, weight_exp: {}, stride: {stride:?}, \
                         padding: {padding:?}, dilation: {dilation:?}, groups: {groups})",
                        kernel(part),
                        part.1,
                        part.2
                    )
                };
                let shapes = [[i[2], i[0], i[1]], [o[2], o[0], o[1]]].map(|shape| format!("{shape:?}"));
                let projections: Vec<_> = [own(i[0] * i[1] * i[2])].into_iter().chain(PARTS.map(window)).collect();
                let text = connection(&shapes[0], &shapes[1], bits, &projections);
                let place = |shape: &[usize], n: usize| n % shape[2] * shape[0] * shape[1] + n / shape[2];
                let wrapped = sums_match(&what, text, &input, &sums, [&|n| place(i, n), &|n| place(o, n)]);
                assert_eq!(wrapped, regime == "wraps_24_bits", "{what}");
                continue;
            }
            let weights = read(if name == "ConvInTime" { "weights" } else { "effective_weights" });
            let [targets, sources] = weights.shape[weights.shape.len() - 2..] else { panic!("a matrix") };
            let delays = (name == "DelayDense").then(|| read("delays"));
            let synapses = |delay: usize| {
                let all = (0..targets).flat_map(|t| (0..sources).map(move |s| (s, t)));
                let of = |(s, t): (usize, usize)| match (&delays, name) {
                    (Some(delays), _) => (s, t, if delays.at([t, s]) == delay as i64 { weights.at([t, s]) } else { 0 }),
                    (_, "ConvInTime") => (s, t, weights.at([weights.shape[0] - 1 - delay, t, s])),
                    _ => (s, t, weights.at([t, s])),
                };
                all.map(of).filter(|synapse| synapse.2 != 0).collect::<Vec<_>>()
            };
            let slots = match name {
                "DelayDense" => 64,
                "ConvInTime" => weights.shape[0],
                _ => 1,
            };
            let slots: Vec<_> = (0..slots).map(|delay| (delay, synapses(delay))).filter(|s| !s.1.is_empty()).collect();
            let exponent = number("weight_exp");
            let mut projections = vec![own(sources)];
            for (delay, synapses) in &slots {
                match given["sign_mode"].as_str() {
                    Some(mode @ ("MIXED" | "EXCITATORY" | "INHIBITORY")) => {
                        let mode = format!("{}{}", &mode[..1], mode[1..].to_lowercase());
                        let bits = number("num_weight_bits");
                        let rest = format!("sign: {mode}, weight_exp: {exponent}, weight_bits: {bits}, delay: {delay}");
                        projections.push(listed(("source", "target"), synapses, &rest));
                    }
                    _ => projections.extend(by_parts(synapses, *delay)),
                }
            }
            let text = connection(&format!("[{sources}]"), &format!("[{targets}]"), bits, &projections);
            assert!(!sums_match(&what, text, &input, &sums, [id, id]), "{what}");
        }
    }
    assert!(regimes > 8, "{regimes}");
}

/// Messages of a target in each step, by unit, for messages `(step, channel, value)`, by engine.
fn answers(network: &Quantised, steps: u32, messages: &[(u32, u32, i32)]) -> Vec<(Vec<BTreeMap<u32, i32>>, Overflow)> {
    let events: Vec<_> = messages.iter().map(|&(step, channel, value)| (step, ChannelId(channel), value)).collect();
    let sample = Sample::with_values(steps, &events, None).unwrap();
    let of_engine = |(_, mut engine): (_, Box<dyn Engine>)| {
        engine.begin(steps);
        let of_step = |step| {
            engine.step(sample.input(step));
            engine.spikes().iter().map(|id| id.0).zip(engine.payloads().iter().copied()).collect()
        };
        ((0..steps).map(of_step).collect(), engine.overflow())
    };
    engines(network).into_iter().map(of_engine).collect()
}

#[test]
fn a_convolution_wraps_where_its_sum_can_reach_24_bits() {
    for (payload, wraps) in [((1 << 22) - 1, false), (1 << 22, true), (-(1 << 22), true)] {
        let text = format!(
            "Network(name: \"c\", timestep_ms: 1.0, output: \"target\", target: \"oheo-gulch\", populations: [
                Input(name: \"in\", shape: [1, 2, 2], payload: {payload}),
                GradedVec(name: \"target\", shape: [1, 2, 2], threshold: 0)],
            projections: [Conv2d(from: [\"in\"], to: \"target\", weights: [[[[1]]]], sign: Excitatory),
                Conv2d(from: [\"in\"], to: \"target\", weights: [[[[-1]]]], sign: Inhibitory),
                Conv2d(from: [\"in\"], to: \"target\", weights: [[[[2]]]], sign: Excitatory, delay: 1)])"
        );
        let network = quantised(text).unwrap();
        // The first two are one convolution, so only its bound counts.
        let apart: Vec<_> = network.projections().iter().map(|p| p.format.apart.map(|apart| apart.wraps)).collect();
        assert_eq!(apart, vec![wraps.then_some(true); 3], "{payload}");
        for (sent, overflow) in answers(&network, 3, &[(0, 2, 1)]) {
            let whole = 2 * i64::from(payload);
            let kept = (whole + (1 << 23)).rem_euclid(1 << 24) - (1 << 23);
            assert_eq!(sent, [vec![], vec![(2, kept as i32)], vec![]].map(BTreeMap::from_iter));
            assert_eq!(overflow.q_wrapped, u64::from(kept != whole), "{payload}");
        }
    }
}

#[test]
fn sums_of_each_declaration_and_delay_are_shifted_apart() {
    let head = "Network(name: \"s\", timestep_ms: 1.0, output: \"target\", target: \"oheo-gulch\", populations: [
        Input(name: \"a\", shape: [2], message_bits: 32), Input(name: \"b\", shape: [1], message_bits: 32),
        GradedVec(name: \"target\", shape: [2], threshold: 0)], projections: [";
    // Weights by target and channel, exponent and delay.
    let declared: [(&str, [[i64; 3]; 2], i32, u32); 4] = [
        ("\"a\", \"b\"", [[3, -6, 5], [-1, 7, 2]], -3, 0),
        ("\"a\"", [[5, 2, 0], [-7, 1, 0]], -3, 0),
        ("\"a\", \"b\"", [[-3, 2, 1], [4, -5, 6]], -2, 2),
        ("\"b\"", [[0, 0, 2], [0, 0, -4]], 1, 0),
    ];
    let matrix = |&(from, weights, exponent, delay): &(&str, [[i64; 3]; 2], i32, u32)| {
        let used = match from {
            "\"a\"" => 0..2,
            "\"b\"" => 2..3,
            _ => 0..3,
        };
        // The weights are doubled, as mixed signs need, and the scale is halved.
        let rows: Vec<Vec<i64>> = weights.iter().map(|row| row[used.clone()].iter().map(|w| 2 * w).collect()).collect();
        let exponent = exponent - 1;
        format!("Dense(from: [{from}], to: \"target\", weights: {rows:?}, weight_exp: {exponent}, delay: {delay})")
    };
    let network = quantised(format!("{head}{}])", declared.each_ref().map(matrix).join(", "))).unwrap();
    let draw = &mut Draw::new(11);
    let steps = 40;
    let values: Vec<[i64; 3]> = (0..steps).map(|_| [0; 3].map(|_: i64| draw.from(-60, 60))).collect();
    let messages: Vec<_> = (0..steps)
        .flat_map(|t| (0..3).map(move |channel| (t, channel)))
        .map(|(t, channel)| (t, channel, values[t as usize][channel as usize] as i32))
        .collect();
    let expected = |t: u32, unit: usize| -> i64 {
        let of = |&(_, weights, exponent, delay): &(&str, [[i64; 3]; 2], i32, u32)| {
            let Some(sent) = t.checked_sub(delay).map(|t| values[t as usize]) else { return 0 };
            let sum: i64 = weights[unit].iter().zip(sent).map(|(w, m)| w * m).sum();
            if exponent < 0 { sum.div_euclid(1 << -exponent) } else { sum << exponent }
        };
        declared.iter().map(of).sum()
    };
    for (sent, _) in answers(&network, steps, &messages) {
        for t in 0..steps {
            for unit in 0..2 {
                let found = sent[t as usize].get(&(unit as u32)).copied().unwrap_or(0);
                assert_eq!(i64::from(found), expected(t, unit), "step {t}, unit {unit}");
            }
        }
    }
    let delays = |count: usize| (0..count).map(|delay| matrix(&("\"a\"", declared[1].1, -3, delay as u32)));
    let many = |others: usize| {
        let all: Vec<String> = delays(63).chain(declared[..others].iter().map(matrix)).collect();
        quantised(format!("{head}{}])", all.join(", ")))
    };
    many(1).unwrap();
    assert!(many(3).unwrap_err().contains("its input makes 66 sums that lava wraps separately, the limit is 64"));
}

/// A trained sigma-delta network from its own file: outputs of every input, and for a moving scene
/// the messages of every layer, by sums that depend on order and signs.
#[test]
fn a_recorded_sigma_delta_network_answers_bit_for_bit() {
    let Some(folder) = data("loihi2/pilotnet_sdnn") else { return };
    let model = foreign::read(&folder.join("network.net"), &foreign::Options::default()).unwrap().model;
    assert_eq!(model.target.as_deref(), Some("oheo-gulch"));
    let network = Network::new(model, SourceText::new("network.net", ""), BTreeMap::new()).unwrap();
    let network = front(&network).unwrap().into_quantised();
    let board = load_target("oheo-gulch").unwrap();
    let compiled = compile(network.clone(), &board, &Options::default()).unwrap();
    // It fits one chip within every limit, by the compiler's count and by the checker's.
    let used = nsim::check::memory::used(&compiled.program, &network, &board).unwrap();
    assert!(used.len() <= 128 && used.len() == compiled.partition.cores(), "{} cores", used.len());
    for used in compiled.partition.usage().iter().chain(&used) {
        assert_eq!(used.excesses(board.limits()).next(), None);
    }
    println!("{} cores", used.len());
    let image = Image::new(&compiled.program, 1).unwrap();
    let layers: Vec<(u32, u32)> = (network.populations().iter())
        .filter_map(|population| Some((population.first_compartment()?.0, population.shape.len())))
        .collect();
    for (scene, engines) in [("recorded", 1), ("moving", 2), ("frames4", 1), ("sparse_changes", 1)] {
        let read = |name: &str| Array::read(&folder.join(scene).join(format!("{name}.npy")));
        let (input, output) = (read("input"), read("output"));
        let steps = output.shape[1];
        // One frame is held for all steps.
        let per_channel = if input.shape.len() == 3 { 1 } else { steps };
        let value = |channel: usize, t: usize| input.values[channel * per_channel + t % per_channel] as i32;
        let channels = input.values.len() / per_channel;
        let events = (0..steps).flat_map(|t| (0..channels).map(move |c| (t as u32, ChannelId(c as u32), value(c, t))));
        let sample = Sample::with_values(steps as u32, &events.collect::<Vec<_>>(), None).unwrap();
        let checks = (scene == "moving").then(|| read("message_checks"));
        let mut fast = Machine::new(&image, Settings::default());
        let mut golden = Golden::new(&network);
        for engine in [&mut fast as &mut dyn Engine, &mut golden].into_iter().take(engines) {
            engine.begin(steps as u32);
            for t in 0..steps {
                engine.step(sample.input(t as u32));
                let sent: BTreeMap<u32, i64> =
                    engine.spikes().iter().map(|id| id.0).zip(engine.payloads().iter().map(|&m| m.into())).collect();
                let (last, _) = layers[layers.len() - 1];
                assert_eq!(sent.get(&last).copied().unwrap_or(0), output.at([0, t]), "{scene}, step {t}");
                for (layer, &(first, units)) in layers.iter().enumerate() {
                    let Some(checks) = &checks else { continue };
                    let sums = sent.range(first..first + units).fold([0; 4], |[sum, size, count, order], (id, m)| {
                        let order = order + m * i64::from(id - first + 1);
                        [sum + m, size + m.abs(), count + 1, order]
                    });
                    let order = sums[3].rem_euclid(1 << 31);
                    for (which, found) in [sums[0], sums[1], sums[2], order].into_iter().enumerate() {
                        assert_eq!(found, checks.at([layer, which, t]), "{scene}, layer {layer}, check {which}, {t}");
                    }
                }
            }
        }
    }
}

/// Without a leak the voltage stays constant, so the neuron would be idle but for its reset.
#[test]
fn a_neuron_is_reset_after_a_silence() {
    let network = alone(NeuronKind::LifReset, &[vec![4096, 0, 131_071, 0, 0, 9, 0]]);
    let sample = Sample::with_values(30, &[(1, ChannelId(0), 3), (12, ChannelId(0), -2)], None).unwrap();
    for (name, mut engine) in engines(&network) {
        engine.begin(30);
        for step in 0..30 {
            engine.step(sample.input(step));
            // lava counts steps from 1.
            let expected = match step {
                1..8 => 3 * 64,
                12..17 => -2 * 64,
                _ => 0,
            };
            assert_eq!(engine.state(CompartmentId(0), 1), expected, "{name}, step {step}");
        }
    }
}

#[test]
fn a_target_whose_messages_carry_nothing_refuses_a_payload_by_name() {
    let mut builder = Builder::new();
    let (input, out) = (builder.input("touch", 2), builder.loihi("out", 2));
    builder.dense(input, out, |_, _| 2);
    let mut parts = builder.build().parts().clone();
    parts.populations.iter_mut().for_each(|population| population.message = Message::Payload(Payload::new(3).unwrap()));
    let (network, loihi1) = (Quantised::new(parts).unwrap(), load_target("loihi1-chip").unwrap());
    let refused = compile(network.clone(), &loihi1, &unsearched()).unwrap_err();
    let said = "messages of population 'touch' carry integers of 3 bits, messages of loihi1-chip carry no integers";
    assert!(refused.to_string().contains(said), "{refused}");
    let CompileError::Input(diagnostic) = refused else { panic!("{refused}") };
    assert!(diagnostic.help.is_some_and(|help| help.starts_with("set message_bits: 3 in a chip of your own")));
    // The proposed remedy.
    let chip = Chip { message_bits: 3, ..loihi1.chip().clone() };
    compile(network, &loihi1.with_chip(chip), &unsearched()).unwrap();
}

#[test]
fn mixed_networks_are_the_same_in_both_engines() {
    let targets = [("roomy", roomy("oheo-gulch")), ("small cores", small_cores("oheo-gulch", 7))];
    let networks = cases(1_000);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
    let compare = |seed| {
        let network = random::mixed(seed);
        let sample = random::valued(&network, seed, 0);
        let golden = trace(&mut Golden::new(&network), &network, &sample);
        let options = unsearched();
        for (what, target) in &targets {
            let program = compile(network.clone(), target, &options).unwrap().program;
            assert_on_machine(&network, &program, &sample, &golden, &format!("network {seed}, {what}"));
        }
        let skipped = golden.totals.active_updates < golden.totals.compartment_updates;
        (golden.totals.spikes, skipped && golden.overflow != Overflow::default())
    };
    let seen: Vec<(u64, bool)> = pool.install(|| (0..networks).into_par_iter().map(compare).collect());
    let spikes: u64 = seen.iter().map(|(spikes, _)| spikes).sum();
    assert!(spikes > 100 * networks, "{spikes}");
    let both = seen.iter().filter(|(_, both)| *both).count() as u64;
    assert!(50 * both > networks, "values leave their words, and compartments rest");
}
