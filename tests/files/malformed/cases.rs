//! The damaged files: each is a valid one with one fault.

/// Argument for which a file is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Through {
    /// As MODEL.
    Model,
    /// As TARGET.
    Target,
    /// As SOURCE of a population of four channels.
    Spikes,
}

/// A file and the expected message.
#[derive(Debug, Clone)]
pub struct Case {
    pub name: String,
    pub through: Through,
    pub file: &'static str,
    pub bytes: Vec<u8>,
    pub beside: Vec<(&'static str, Vec<u8>)>,
    pub code: &'static str,
    pub line: Option<usize>,
    pub says: &'static str,
}

pub const MODEL: &str = r#"Network(
    name: "x",
    timestep_ms: 1.0,
    populations: [
        Input(name: "in", shape: [4]),
        Loihi(name: "o", shape: [2], du: 1024, dv: 128, vth_mant: 80, refractory: 1),
    ],
    projections: [
        Dense(from: ["in"], to: "o", weights: [[2, 2, 2, 2], [4, 4, 4, 4]], weight_exp: 0, delay: 0),
    ],
    output: "o",
)
"#;

/// The weights of the model.
const WEIGHTS: &str = "[[2, 2, 2, 2], [4, 4, 4, 4]]";

/// What rows of rules replace.
const RULE: &str = "delay: 0";
const LEARNING: &str = "model.learning";
const DENSE: &str = "Dense(from: [\"in\"], to: \"o\", weights: [[2, 2, 2, 2], [4, 4, 4, 4]], weight_exp: 0, delay: 0),";
const TWO_NAMES: &str = "Random(name: \"a\", from: [\"in\"], to: \"o\", fan_out: 1, low: 2, high: 2, seed: 1),
        Random(name: \"a\", from: [\"in\"], to: \"o\", fan_out: 1, low: 2, high: 2, seed: 1),";

const TARGET: &str = r#"Target(
    name: "t", notes: "",
    chip: "tiny",
    chips_x: 1, chips_y: 1,
    constants: ["davies2018"],
)
"#;

/// An array file in NumPy's format.
pub fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(data);
    bytes
}

fn safetensors(json: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = (json.len() as u64).to_le_bytes().to_vec();
    bytes.extend(json.bytes());
    bytes.extend(data);
    bytes
}

fn lfs_pointer() -> Vec<u8> {
    // git-lfs docs/spec.md
    format!("version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 12628\n", "0f".repeat(32)).into_bytes()
}

/// Reproducible random bytes.
fn noise(length: usize) -> Vec<u8> {
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    (0..length)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as u8
        })
        .collect()
}

/// The valid files from which the others are made.
pub fn sound() -> Vec<Case> {
    let case = |name: &str, through, file, bytes: Vec<u8>| Case {
        name: name.to_string(),
        through,
        file,
        bytes,
        beside: Vec::new(),
        code: "",
        line: None,
        says: "",
    };
    vec![
        case("model", Through::Model, "m.ron", MODEL.into()),
        case("target", Through::Target, "t.ron", TARGET.into()),
        case("array", Through::Spikes, "s.npy", npy("'|u1'", "(4, 3)", &[1; 12])),
        case("events", Through::Spikes, "s.csv", b"# steps: 5\n0,1\n4,3\n".to_vec()),
    ]
}

/// Every damaged file.
pub fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    let mut add = |name: &str, through, file, bytes: Vec<u8>, beside, code, line: usize, says| {
        let line = (line > 0).then_some(line);
        cases.push(Case { name: name.to_string(), through, file, bytes, beside, code, line, says });
    };

    // Model files: replaced text, its replacement, code, line (0: the file as a whole), message.
    let syntax = "model.syntax";
    let replaced: [(&str, &str, &str, &'static str, usize, &'static str); 77] = [
        ("unknown field", "dv: 128", "dw: 128", syntax, 6, "`Loihi` has no field `dw`"),
        ("unknown kind of population", "Loihi(", "Loki(", syntax, 6, "Loki"),
        ("unknown kind of projection", "Dense(", "Dence(", syntax, 9, "Dence"),
        ("unknown kind of file", "Network(", "Netwerk(", syntax, 1, "Network"),
        ("field twice", "du: 1024", "du: 1024, du: 1024", syntax, 6, "du"),
        ("missing field", "    output: \"o\",\n", "", syntax, 11, "output"),
        ("trailing text", "output: \"o\",\n)", "output: \"o\",\n) x", syntax, 12, "railing"),
        // The next quote, three lines below, closes it.
        ("unclosed string", "\"o\", shape", "\"o, shape", syntax, 9, "comma"),
        ("word for a number", "du: 1024", "du: fast", syntax, 6, ""),
        ("string for a number", "du: 1024", "du: \"1024\"", syntax, 6, "expected a number"),
        ("negative shape", "shape: [4]", "shape: [-4]", syntax, 5, ""),
        ("number for weights", WEIGHTS, "2", syntax, 9, "list of rows"),
        ("ragged weights", "[4, 4, 4, 4]", "[4, 4, 4]", syntax, 9, "3 here, 4 before"),
        ("weights of mixed depth", "[4, 4, 4, 4]", "4", syntax, 9, "other rows have a list"),
        ("a list among numbers", "[4, 4, 4, 4]", "[4, 4, [4], 4]", syntax, 9, "other rows have a number"),
        ("weights too deep", "[2, 2, 2, 2]", "[[[[2]]]]", syntax, 9, "deeper than 4"),
        ("a word among weights", "[4, 4, 4, 4]", "[4, 4, four, 4]", syntax, 9, "a number or a list of numbers"),
        ("a text among weights", "[4, 4, 4, 4]", "[4, 4, \"4\", 4]", syntax, 9, "a number or a list of numbers"),
        ("NaN among weights", "[4, 4, 4, 4]", "[4, 4, NaN, 4]", syntax, 9, "NaN"),
        ("infinity among weights", "[4, 4, 4, 4]", "[4, 4, -inf, 4]", syntax, 9, "inf"),
        ("NaN parameter", "du: 1024", "du: NaN", syntax, 6, "expected a number"),
        ("unknown source", WEIGHTS, "Npz(\"a\")", syntax, 9, "Npz"),
        ("unknown sign", "weight_exp: 0", "sign: Both", syntax, 9, "Both"),
        ("number beyond 64 bits", "shape: [4]", "shape: [99999999999999999999999]", syntax, 5, ""),
        ("fractional delay", "delay: 0", "delay: 1.5", syntax, 9, "expected a whole number but found 1.5"),
        ("weights without a comma", "[4, 4, 4, 4]", "[4, 4 4, 4]", syntax, 9, "comma"),
        ("weights that do not end", "[4, 4, 4, 4]]", "[4, 4, 4, 4]", syntax, 9, "closing bracket"),
        ("range downward", WEIGHTS, "Uniform(low: 2, high: 1, seed: 1)", "model.uniform", 9, "2 to 1 is not a range"),
        ("NaN timestep", "1.0", "NaN", "model.timestep", 3, "NaN"),
        ("no timestep", "1.0", "0", "model.timestep", 3, "0"),
        ("decay too large", "du: 1024", "du: 5000", "model.range", 6, "decay 5000 is outside 0..=4096"),
        ("negative decay", "du: 1024", "du: -1", "model.range", 6, "decay -1"),
        ("fractional decay", "du: 1024", "du: 10.5", "model.not-integer", 6, "10.5"),
        (
            "decays of another number",
            "du: 1024",
            "du: [1, 2, 3]",
            "model.parameter-size",
            6,
            "3 values for 2 compartments",
        ),
        ("threshold too large", "vth_mant: 80", "vth_mant: 131072", "model.range", 6, "131072 is outside 0..=131071"),
        ("refractory too long", "refractory: 1", "refractory: 256", "model.range", 6, "256 is outside 0..=255"),
        ("bias too large", "refractory: 1", "bias_mant: 4096", "model.range", 6, "4096"),
        ("weight too large", "[4, 4, 4, 4]", "[4, 4, 4, 400]", "model.weight-range", 9, "400"),
        ("weight not whole", "[4, 4, 4, 4]", "[4, 4, 4, 4.5]", "model.weight-not-integer", 9, "4.5"),
        ("weight of the wrong sign", "weight_exp: 0", "sign: Inhibitory", "model.weight-range", 9, "Inhibitory"),
        ("weight exponent", "weight_exp: 0", "weight_exp: 8", "model.synapse-format", 9, "8"),
        ("seven bits", "weight_exp: 0", "weight_bits: 7", "model.synapse-format", 9, "7"),
        ("delay too long", "delay: 0", "delay: 63", "model.delay-range", 9, "63"),
        ("rows for another target", ", [4, 4, 4, 4]]", "]", "model.weights-shape", 9, "[1, 4]"),
        ("huge population", "shape: [4]", "shape: [4000000000000]", "model.shape", 5, "4000000000000"),
        ("overflowing shape", "shape: [4]", "shape: [4294967296, 4294967296, 4]", "model.shape", 5, "4294967296"),
        ("empty population", "shape: [4]", "shape: [0]", "model.shape", 5, "[0]"),
        ("two axes", "shape: [4]", "shape: [2, 2]", "model.shape", 5, "2 axes"),
        ("name twice", "name: \"o\"", "name: \"in\"", "model.name-twice", 6, "'in'"),
        ("name with a dot", "name: \"o\"", "name: \"o.v\"", "model.name", 6, "o.v"),
        ("unknown target", "to: \"o\"", "to: \"p\"", "model.unknown-population", 9, "populations are: in, o"),
        ("unknown source population", "from: [\"in\"]", "from: [\"inn\"]", "model.unknown-population", 9, "'inn'"),
        ("unknown output", "output: \"o\"", "output: \"z\"", "model.unknown-population", 11, "'z'"),
        ("output that is an input", "output: \"o\"", "output: \"in\"", "model.output", 11, "'in'"),
        ("too few classes", "output: \"o\"", "output: \"o\", classes: [\"a\"]", "model.classes", 11, "1 class"),
        ("rule of an unknown factor", RULE, "learning: Rule(dw: \"x0*q\")", LEARNING, 9, "'q' is unknown"),
        ("rule without dependency", RULE, "learning: Rule(dt: \"2^-2*x1\")", LEARNING, 9, "dt: a product needs x0, y0"),
        ("rule that changes nothing", RULE, "learning: Rule(epoch: 4)", LEARNING, 9, "give dw, dd or dt"),
        (
            "epoch too long",
            RULE,
            "learning: Rule(dw: \"x0\", epoch: 64)",
            LEARNING,
            9,
            "epoch of 64 steps is not 1 to 63",
        ),
        ("two k of u", RULE, "learning: Rule(dw: \"u0\", dt: \"u1*x1\")", LEARNING, 9, "but u0 and u1 are used"),
        (
            "PES",
            RULE,
            "learning: Pes(error: \"in\", x1: (impulse: 1, tau: 1))",
            LEARNING,
            9,
            "learning_semantics: Nengo",
        ),
        ("PES without a trace", RULE, "learning: Pes(error: \"in\")", syntax, 9, "`x1`"),
        (
            "reward",
            RULE,
            "learning: Rule(dw: \"u0\", r1: (from: \"z\", impulse: 1, tau: 1))",
            "model.unknown-population",
            9,
            "'z'",
        ),
        ("reward channel r0", RULE, "learning: Rule(dw: \"u0*r0\")", LEARNING, 9, "'r0' is unknown"),
        ("great impulse", RULE, "learning: Rule(dw: \"x0\", x1: (impulse: 128, tau: 1))", syntax, 9, "impulse of 128"),
        ("signal that is none", RULE, "learning: Rule(dw: \"x0\", y2: Signal(\"in\"))", LEARNING, 9, "declare it so"),
        ("unknown signal", RULE, "learning: Rule(dw: \"x0\", y2: Signal(\"r\"))", "model.unknown-population", 9, "'r'"),
        ("delays that act", RULE, "learning: Rule(dd: \"x0\", delays: 1)", LEARNING, 9, "the projection's delay"),
        (
            "tags of another shape",
            RULE,
            "learning: Rule(dt: \"x0\", tags: [1, 2])",
            LEARNING,
            9,
            "[2], the synapses are [2, 4]",
        ),
        (
            "tag too large",
            RULE,
            "learning: Rule(dt: \"x0\", tags: 256)",
            LEARNING,
            9,
            "256 is not a whole number from -256 to 255",
        ),
        (
            "payload of spikes",
            RULE,
            "learning: Rule(dw: \"x0\", graded: Overwrite)",
            LEARNING,
            9,
            "'in' sends plain spikes",
        ),
        ("learning semantics", "output: \"o\"", "output: \"o\", learning_semantics: Brain", syntax, 11, "`Brain`"),
        (
            "rule of a pool",
            DENSE,
            "SumPool2d(from: [\"in\"], to: \"o\", kernel: (1, 1), weight: 2, learning: Rule(dw: \"x0\")),",
            LEARNING,
            9,
            "list the synapses",
        ),
        (
            "source twice",
            "from: [\"in\"]",
            "learning: Rule(dw: \"x0\"), from: [\"in\", \"in\"]",
            LEARNING,
            9,
            "two projections",
        ),
        ("projection's name", RULE, "name: \"a->b\"", "model.name", 9, "'a->b'"),
        ("two projections of a name", DENSE, TWO_NAMES, "model.name-twice", 10, "its own name"),
        ("spikes of a signal", "Input(", "Signal(", "model.source", 9, "declare it as Input"),
    ];
    for (name, from, to, code, line, says) in replaced {
        assert!(MODEL.contains(from), "{name}");
        let text = MODEL.replacen(from, to, 1);
        add(name, Through::Model, "m.ron", text.into(), vec![], code, line, says);
    }
    add("empty", Through::Model, "m.ron", vec![], vec![], syntax, 1, "");
    add("truncated", Through::Model, "m.ron", MODEL[..150].into(), vec![], syntax, 6, "");
    add("noise", Through::Model, "m.ron", noise(4096), vec![], "io.utf8", 1, "not UTF-8");
    let (array, none) = (npy("'|u1'", "(1,)", &[1]), "not a file of a VT_SNN network");
    add("an array as a model", Through::Model, "m.ron", array, vec![], "import.slayer", 0, none);
    add("pointer as a model", Through::Model, "m.ron", lfs_pointer(), vec![], "io.lfs-pointer", 0, "git lfs pull");
    let deep = MODEL.replace(WEIGHTS, &"[".repeat(200_000));
    add("brackets without end", Through::Model, "m.ron", deep.into(), vec![], syntax, 9, "");
    let braces = "(".repeat(200_000);
    add("only brackets", Through::Model, "m.ron", braces.into(), vec![], syntax, 1, "");
    let comment = "/*".repeat(200_000);
    add("comments without end", Through::Model, "m.ron", comment.into(), vec![], syntax, 1, "");

    // Arrays next to a model.
    let with = |source: &str| MODEL.replace(WEIGHTS, source).into_bytes();
    let arrays: [(&str, Vec<u8>, &'static str, &'static str); 13] = [
        ("random bytes", noise(4096), "npy.format", "w.npy: this is not a NumPy array"),
        ("empty array file", vec![], "npy.format", "w.npy"),
        ("pointer as an array", lfs_pointer(), "io.lfs-pointer", "w.npy: this is a Git-LFS pointer"),
        ("truncated array", npy("'<i2'", "(2, 4)", &[0; 15]), "npy.truncated", "needs 16 bytes"),
        ("trailing bytes", npy("'<i2'", "(2, 4)", &[0; 17]), "npy.trailing", "needs 16 bytes"),
        ("huge shape", npy("'<f8'", "(4000000000, 4000000000)", &[0; 64]), "npy.shape", "64 follow"),
        ("overflowing array", npy("'|u1'", "(9223372036854775808, 2, 0)", &[]), "npy.shape", "shape"),
        ("objects", npy("'|O'", "(2,)", &[0; 64]), "npy.dtype", "Python objects"),
        ("complex numbers", npy("'<c16'", "(2,)", &[0; 32]), "npy.dtype", "complex"),
        ("records", npy("[('a', '<i4')]", "(2,)", &[0; 8]), "npy.dtype", "several fields"),
        ("NaN in an array", npy("'<f4'", "(1,)", &f32::NAN.to_le_bytes()), "npy.value", "[0] is NaN"),
        ("wide integer", npy("'<i8'", "(1,)", &i64::MAX.to_le_bytes()), "npy.value", "9223372036854775807"),
        ("array of another shape", npy("'|i1'", "(4, 2)", &[0; 8]), "model.weights-shape", "[4, 2]"),
    ];
    for (name, bytes, code, says) in arrays {
        add(name, Through::Model, "m.ron", with("Npy(\"w.npy\")"), vec![("w.npy", bytes)], code, 9, says);
    }
    add("absent array", Through::Model, "m.ron", with("Npy(\"absent.npy\")"), vec![], "io.missing", 9, "absent.npy");
    add("folder as an array", Through::Model, "m.ron", with("Npy(\".\")"), vec![], "io.folder", 9, "folder");
    let json = r#"{"fc":{"dtype":"I8","shape":[2,4],"data_offsets":[0,8]}}"#;
    let tensors: [(&str, Vec<u8>, &'static str, &'static str); 4] = [
        ("absent key", safetensors(json, &[0; 8]), "safetensors.key", "tensors of the file: fc"),
        ("truncated tensors", safetensors(json, &[0; 7]), "safetensors.format", "w.st"),
        ("noise as tensors", noise(4096), "safetensors.format", "w.st"),
        ("header that claims too much", vec![0xff; 16], "safetensors.format", "w.st"),
    ];
    for (name, bytes, code, says) in tensors {
        add(name, Through::Model, "m.ron", with("Safetensors(\"w.st\", \"fd\")"), vec![("w.st", bytes)], code, 9, says);
    }

    // Targets.
    let replaced: [(&str, &str, &str, &'static str, usize, &'static str); 7] = [
        ("no chips", "chips_x: 1", "chips_x: 0", "target.size", 4, "chips_x 0"),
        ("too many chips", "chips_y: 1", "chips_y: 129", "target.size", 4, "chips_y 129"),
        ("negative chips", "chips_x: 1", "chips_x: -1", "target.syntax", 4, ""),
        ("unknown chip", "\"tiny\"", "\"titanic\"", "target.part", 3, "loihi1"),
        ("unknown constants", "\"davies2018\"", "\"davies\"", "target.part", 5, "davies2018"),
        ("no constants", "[\"davies2018\"]", "[]", "target.constants", 0, "no preset"),
        ("unknown target field", "chips_x: 1", "chips: 1", "target.syntax", 4, "chips"),
    ];
    for (name, from, to, code, line, says) in replaced {
        assert!(TARGET.contains(from), "{name}");
        add(name, Through::Target, "t.ron", TARGET.replacen(from, to, 1).into(), vec![], code, line, says);
    }
    add("model as a target", Through::Target, "t.ron", MODEL.into(), vec![], "target.syntax", 1, "Target");
    let bad_chip = b"Chip(name: \"tiny\",".to_vec();
    add("damaged chip", Through::Target, "t.ron", TARGET.into(), vec![("tiny.ron", bad_chip)], "chip.syntax", 1, "");

    // Spikes.
    let empty = b"DataSet(name: \"\", populations: {\"a\": \"a\"}, samples: [])";
    let absent = b"DataSet(name: \"\", populations: {\"a\": \"in\"},\nsamples: [(files: {\"a\": \"x.npy\"})])";
    type Spikes = (&'static str, &'static str, Vec<u8>, &'static str, usize, &'static str);
    let spikes: [Spikes; 14] = [
        ("spikes of noise", "s.npy", noise(4096), "npy.format", 0, "not a NumPy array"),
        ("spikes of another shape", "s.npy", npy("'|u1'", "(2, 3, 5)", &[0; 30]), "input.shape", 0, "4 channels"),
        ("a single number", "s.npy", npy("'|u1'", "()", &[0]), "input.shape", 0, "single number"),
        ("no timestep", "s.npy", npy("'|u1'", "(4, 0)", &[]), "input.shape", 0, "no timestep"),
        ("pointer as spikes", "s.npy", lfs_pointer(), "io.lfs-pointer", 0, "git lfs pull"),
        ("channel outside", "s.csv", b"0,1\n1,4\n".to_vec(), "input.channel", 2, "channel 4"),
        ("step outside", "s.csv", b"# steps: 3\n0,1\n3,1\n".to_vec(), "input.step", 3, "timestep 3"),
        ("step beyond all measure", "s.csv", b"4294967295,1\n".to_vec(), "input.step", 1, "4294967295"),
        ("word in a row", "s.csv", b"0,1\n1,one\n".to_vec(), "input.csv", 2, "one"),
        ("unknown header", "s.csv", b"a,b,c\n0,1,2\n".to_vec(), "input.csv", 1, "timestep,channel"),
        ("no event", "s.csv", b"\n".to_vec(), "input.empty", 0, "# steps"),
        ("unknown kind", "s.xyz", b"0,1\n".to_vec(), "input.kind", 0, ".csv"),
        ("manifest without samples", "s.ron", empty.to_vec(), "dataset.samples", 0, "no sample"),
        ("manifest of absent files", "s.ron", absent.to_vec(), "io.missing", 2, "x.npy"),
    ];
    for (name, file, bytes, code, line, says) in spikes {
        add(name, Through::Spikes, file, bytes, vec![], code, line, says);
    }
    cases
}
