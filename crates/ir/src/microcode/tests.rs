//! Tests of the grammar, of the intervals, and of every error.

use super::*;

/// A kind with these assignments; `|` separates the assignments of the update.
fn kind(update: &str, spikes: Option<&str>, message: Option<&str>, reset: &[&str]) -> Result<Microcode, Problem> {
    let word = |name: &str, bits, overflow| Word { name: name.to_string(), bits, overflow };
    let parameter = |name: &str, range| Parameter { name: name.to_string(), range, default: None };
    let declaration = Declaration {
        name: "Own".to_string(),
        state: vec![word("v", 24, Overflow::Clip), word("u", 32, Overflow::Wrap)],
        parameters: vec![parameter("k", (0, 7)), parameter("dv", (0, 4096))],
        temporaries: vec![word("t", 16, Overflow::Wrap)],
        update: update.split('|').map(|line| line.trim().to_string()).filter(|line| !line.is_empty()).collect(),
        spikes: spikes.map(str::to_string),
        message: message.map(str::to_string),
        reset: reset.iter().map(ToString::to_string).collect(),
        time: None,
        energy: None,
    };
    Microcode::new(declaration, 8)
}

/// The test of a kind as a text, with the operation before each bracket of operands.
fn bracketed(text: &str) -> String {
    fn shown(expression: &Expression) -> String {
        match &expression.node {
            Node::Constant(value) => value.to_string(),
            Node::Read(Variable::Arrived(port)) => ["in", "in2"][*port].to_string(),
            Node::Read(Variable::Parameter(place)) => ["k", "dv"][*place].to_string(),
            Node::Read(Variable::State(place)) => ["v", "u"][*place].to_string(),
            Node::Read(Variable::Temporary(place)) => format!("t{place}"),
            Node::Apply(operation, of) => {
                let of: Vec<String> = of.iter().map(shown).collect();
                format!("{operation:?}({})", of.join(" "))
            }
        }
    }
    shown(kind("", Some(text), None, &[]).unwrap().sends())
}

#[test]
fn operators_bind_as_in_python() {
    for (text, meant) in [
        ("v - u - 1", "Subtract(Subtract(v u) 1)"),
        ("v + u * k", "Add(v Multiply(u k))"),
        ("v + u >> k", "ShiftRight(Add(v u) k)"),
        ("-v * 2", "Multiply(Subtract(0 v) 2)"),
        ("v - -1", "Subtract(v Subtract(0 1))"),
        ("v >= k << 2", "LessOrEqual(ShiftLeft(k 2) v)"),
        ("v > 1 and u < 2 or not k == 3", "Or(And(Less(1 v) Less(u 2)) Not(Equal(k 3)))"),
        ("not not v", "Not(Not(v))"),
        ("(v + u) * k", "Multiply(Add(v u) k)"),
        ("select(v != u, tz(v, k), abs(u))", "Select(NotEqual(v u) TowardZero(v k) Absolute(u))"),
        ("clip(v*dv, 24) + wrap(u,8)", "Add(Clip(24)(Multiply(v dv)) Wrap(8)(u))"),
        ("min(1_000, max(in, in2))", "Minimum(1000 Maximum(in in2))"),
    ] {
        assert_eq!(bracketed(text), meant, "{text}");
    }
}

#[test]
fn a_kind_knows_its_ports_temporaries_and_instructions() {
    let own = kind("t = v + in | x = t * 2 | u = x", Some("v > 3"), Some("u"), &["v = 0", "x = 1"]).unwrap();
    assert_eq!((own.ports(), own.temporaries()), (1, 2));
    // Two operations, a copy, a comparison, two copies, and the sending.
    assert_eq!(own.instructions(), 1 + 1 + 1 + 1 + 2 + 1);
    assert_eq!(kind("v = in + in2", Some("1"), None, &[]).unwrap().ports(), 2);
    let quiet = kind("", None, Some("v"), &[]).unwrap();
    assert_eq!(Some(quiet.sends()), quiet.message());
}

#[test]
fn a_kind_has_at_most_2048_instructions() {
    // 127 sums of 16 operations, one of the rest, and the sending.
    let of = |operations: usize| format!("t = 1{}", "+1".repeat(operations));
    let sums = |last: usize| kind(&format!("{} | {}", vec![of(16); 127].join(" | "), of(last)), Some("1"), None, &[]);
    assert_eq!(sums(15).unwrap().instructions(), 2048);
    let problem = sums(16).unwrap_err();
    assert!(problem.message.contains("2049 instructions, more than 2048"), "{}", problem.message);
}

#[test]
fn an_update_costs_what_is_stated_or_its_instructions() {
    let declared =
        kind("u = tz(u * (4096 - k), 12) + in | v = tz(v * (4096 - dv), 12) + u + 7", Some("v > 9"), None, &["v = 0"]);
    let compartment = declared.unwrap();
    assert_eq!(compartment.price(), UpdatePrice::Instructions(COMPARTMENT_INSTRUCTIONS));
    let price = |time: Option<&str>, energy: Option<&str>| {
        let [time, energy] = [time, energy].map(|text| text.map(str::to_string));
        Microcode::new(Declaration { time, energy, ..compartment.declaration().clone() }, 8).map(|code| code.price())
    };
    let stated = UpdatePrice::Stated { energy: 12_000, time: 5_000 };
    assert_eq!(price(Some("5ns"), Some("12pJ")).unwrap(), stated);
    assert_eq!(price(Some("0.005us"), Some("0.012nJ")).unwrap(), stated);
    for (time, energy, path, says) in [
        (Some("5ns"), None, "time", "no energy"),
        (None, Some("12pJ"), "energy", "no time"),
        (Some("5"), Some("12pJ"), "time", "no unit"),
        (Some("5pJ"), Some("12pJ"), "time", "pJ is not a valid unit"),
        (Some("5ns"), Some("-1pJ"), "energy", "outside 0..=100000 pJ"),
        (Some("1s"), Some("12pJ"), "time", ""),
    ] {
        let problem = price(time, energy).unwrap_err();
        assert!(problem.path == path && problem.message.contains(says), "{problem:?}");
    }
}

/// Small intervals are tested by every pair of values.
#[test]
fn intervals_hold_every_result_and_touch_both_ends() {
    use Operation::*;
    let ranges = [(-5, 3), (0, 4), (-6, -2), (2, 7), (0, 0)];
    for operation in [Add, Subtract, Multiply, ShiftLeft, ShiftRight, TowardZero, Minimum, Maximum] {
        for (a, b) in ranges.iter().flat_map(|a| ranges.iter().map(move |b| (*a, *b))) {
            let of = [a, b].map(|(low, high)| Interval { low, high });
            let value = |x: i64, y: i64| match operation {
                Add => x + y,
                Subtract => x - y,
                Multiply => x * y,
                ShiftLeft => x << y,
                ShiftRight => x >> y,
                TowardZero => x / (1 << y),
                Minimum => x.min(y),
                _ => x.max(y),
            };
            let found = interval::result(operation, &of);
            if matches!(operation, ShiftLeft | ShiftRight | TowardZero) && b.0 < 0 {
                assert!(found.is_err());
                continue;
            }
            let all = (a.0..=a.1).flat_map(|x| (b.0..=b.1).map(move |y| value(x, y)));
            let meant = Interval { low: all.clone().min().unwrap(), high: all.max().unwrap() };
            assert_eq!(found, Ok(meant), "{operation:?} {a:?} {b:?}");
        }
    }
    for (low, high) in ranges {
        let of = Interval { low, high };
        let all = (low..=high).map(i64::abs);
        let meant = Interval { low: all.clone().min().unwrap(), high: all.max().unwrap() };
        assert_eq!(interval::result(Absolute, &[of]), Ok(meant));
    }
    let all = [Interval::of_bits(64); 2];
    assert!([Add, Subtract, Multiply].iter().all(|operation| interval::result(*operation, &all).is_err()));
    assert_eq!(Interval { low: -1, high: 1 }.bits(), 2);
    assert_eq!((Interval::of_bits(64).bits(), Interval::one(0).bits(), Interval::one(-129).bits()), (64, 1, 9));
}

#[test]
fn every_problem_is_named_with_its_place() {
    let test = |text: &'static str| kind("", Some(text), None, &[]);
    let update = |text: &'static str| kind(text, Some("1"), None, &[]);
    let deep = "(".repeat(50) + "1" + &")".repeat(50);
    let signs = "-".repeat(60) + "1";
    let long = "v + ".repeat(600) + "v";
    for (found, path, at, part) in [
        (test("w + 1"), "spikes", 0, "'w' is not defined: names are in, in2, k, dv, v, u"),
        (test("v > clib(u, 3)"), "spikes", 4, "did you mean 'clip'?"),
        (test("v > 1 +"), "spikes", 7, "expected a number, a name or a bracket but found the end"),
        (test("v ** 2"), "spikes", 3, "found '*'"),
        (test("v = 2"), "spikes", 2, "== compares"),
        (test("v > 1.5"), "spikes", 5, "numbers are integers"),
        (test("v / 2"), "spikes", 2, "tz(a, k)"),
        (test("v & 2"), "spikes", 2, "write and, or, not"),
        (test("1 < v < 3"), "spikes", 6, "comparisons do not chain"),
        (test("v 3"), "spikes", 2, "expected the end but found '3'"),
        (test("(v"), "spikes", 2, "expected ')' but found the end"),
        (test("tz(v)"), "spikes", 4, "expected ',' but found ')'"),
        (test("abs(v, 1)"), "spikes", 5, "expected ')' but found ','"),
        (test("clip(v, k)"), "spikes", 0, "clip(x, bits) takes a number of 2 to 63 bits"),
        (test("wrap(v, 64)"), "spikes", 0, "wrap(x, bits) takes a number of 2 to 63 bits"),
        (test("99999999999999999999"), "spikes", 0, "is not an integer of 64 bits"),
        (test("u * u * u"), "spikes", 6, "the result can need 94 bits of 64: clip(.., bits) or wrap(.., bits)"),
        (test("v << u"), "spikes", 2, "a shift by -2147483648 to 2147483647 bits is outside 0..=62"),
        (test("1 >> (k - 1)"), "spikes", 2, "a shift by -1 to 6 bits"),
        (test("t"), "spikes", 0, "'t' is read before it is assigned"),
        (test("and 3"), "spikes", 0, "found 'and'"),
        (test("v + \u{e9}"), "spikes", 4, "found '\u{e9}'"),
        (kind("", Some(&deep), None, &[]), "spikes", 40, "nested more than 40 deep"),
        (kind("", Some(&signs), None, &[]), "spikes", 40, "nested more than 40 deep"),
        (kind("", Some(&long), None, &[]), "spikes", 0, "2401 bytes are more than 2000"),
        (update("k = 3"), "update.[0]", 0, "'k' is an input"),
        (update("v = in | in = 3"), "update.[1]", 0, "'in' is an input"),
        (update("v + 1"), "update.[0]", 2, "expected '=' but found '+'"),
        (update("3 = v"), "update.[0]", 0, "expected a name to assign to"),
        (update("x = x + 1"), "update.[0]", 4, "'x' is not defined"),
        (update("min = 3"), "update.[0]", 0, "'min' cannot be a name here: it already has a meaning"),
        (kind("", None, None, &[]), "", 0, "it sends nothing"),
        (kind("", None, Some("u + u"), &[]), "message", 0, "a message of 33 bits does not fit 32"),
        (kind("", Some("1"), None, &["v = y"]), "reset.[0]", 4, "'y' is not defined"),
    ] {
        let problem = found.unwrap_err();
        assert_eq!((problem.path.as_str(), problem.at), (path, at), "{problem}");
        assert!(problem.message.contains(part), "{problem}: {part}");
    }
    let many = kind(&vec!["v = 1"; 129].join("|"), Some("1"), None, &[]).unwrap_err();
    assert!(many.message.contains("129 update are more than the 128"), "{many}");
}

#[test]
fn declared_names_widths_and_ranges_are_checked() {
    type Change = fn(&mut Declaration);
    let changes: [(Change, &str, &str); 11] = [
        (|d| d.name = "2x".to_string(), "name", "'2x' cannot be the name of a kind"),
        (|d| d.state[0].name = "in".to_string(), "state.[0]", "it already has a meaning"),
        (|d| d.state[0].name = "a b".to_string(), "state.[0]", "use letters, digits"),
        (|d| d.state[1].name = "k".to_string(), "state.[1]", "it is declared twice"),
        (|d| d.parameters[1].name = "shape".to_string(), "parameters.[1]", "it already has a meaning"),
        (|d| d.state[1].bits = 33, "state.[1]", "33 bits are outside 2..=32"),
        (|d| d.temporaries[0].bits = 1, "temporaries.[0]", "1 bits are outside 2..=32"),
        (|d| d.parameters[0].range = (3, 2), "parameters.[0]", "the range 3 to 2 is not valid"),
        (|d| d.parameters[0].default = Some(9), "parameters.[0]", "0 to 7 with the default 9"),
        (|d| d.state = vec![d.state[0].clone(); 9], "state", "9 state are more than the 8"),
        (|d| d.parameters = vec![d.parameters[0].clone(); 9], "parameters", "9 parameters are more than the 8"),
    ];
    let plain = kind("", Some("v > 0"), None, &[]).unwrap();
    for (change, path, part) in changes {
        let mut declaration = plain.declaration().clone();
        change(&mut declaration);
        let problem = Microcode::new(declaration, 8).unwrap_err();
        assert!(problem.path == path && problem.message.contains(part), "{problem:?}");
    }
}

/// Texts of tokens in any order are parsed or refused, and overflow no stack and no number.
#[test]
fn random_texts_are_read_or_refused() {
    let words =
        "v u k in in2 ( ) , + - * << >> < == and or not min( clip( select( 1 62 9223372036854775807 = \u{1f600} \" t";
    let tokens: Vec<&str> = words.split(' ').chain([" "]).collect();
    let mut read = 0;
    for seed in 0..20_000u64 {
        let length = crate::base::rng::below(24, seed, 0, 0);
        let token = |place: u64| tokens[crate::base::rng::below(tokens.len() as u64, seed, 1, place) as usize];
        let text: Vec<&str> = (0..length).map(token).collect();
        read += u32::from(kind(&text.join(" "), Some("1"), Some(&text.join("")), &[]).is_ok());
        read += u32::from(kind("", Some(&text.join(" ")), None, &[]).is_ok());
    }
    assert!(read > 100, "{read}");
}
