//! What the fuzz targets of `tests/fuzz` check for any bytes. `cargo test` runs their corpora.

use std::num::NonZeroU32;
use std::sync::Arc;

use nsim::compile::{CompileError, Effort, Objective, Options, Strategy, compile, load};
use nsim::files::lower::lower;
use nsim::files::mapping::{mapping as read, mapping_text};
use nsim::files::network::{Network, NetworkFile};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::ir::base::diagnostic::SourceText;
use nsim::ir::base::id::{CompartmentId, RuleId};
use nsim::ir::hardware::Target;
use nsim::ir::learning::{Column, Trace, Variable, parse};
use nsim::ir::mapping::MappingFile;
use nsim::ir::program::Program;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::integers;
use nsim::quantise::prune::{Plan, prune};
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::{Outcome, SampleSettings, Session};

use super::compare::{assert_on_machine, roomy, small_cores, trace};
use super::random::{self, Draw};
use super::unsearched;

/// A network of any kinds and options of its mapping: the machine gives what the interpreter gives,
/// sums equal totals, and neither pruning nor an early exit changes a decision.
pub fn network(bytes: &[u8]) {
    let draw = &mut Draw::of_bytes(bytes);
    let (network, sample) = drawn_network(draw);
    let options = drawn_options(draw);
    let target = match draw.chance(50) {
        true => roomy("oheo-gulch"),
        false => small_cores("oheo-gulch", draw.from(1, 60) as u32),
    };
    let Some(program) = mapped(&network, &Options { copies: 1, ..options }, &target) else { return };
    mapped(&network, &options, &target);
    let golden = trace(&mut Golden::new(&network), &network, &sample);
    assert_on_machine(&network, &program, &sample, &golden, "drawn");
    let rule = match draw.from(0, 6) as u32 {
        0 => Rule::Certain,
        margin => Rule::Margin(NonZeroU32::new(margin).unwrap()),
    };
    let exit = EarlyExit::new(rule, &network).ok();
    let settings = SampleSettings { early_exit: exit, ..SampleSettings::new(network.output()) };
    let image = Image::new(&program, draw.from(1, 4) as usize).unwrap();
    let fast = Machine::new(&image, Settings { skip: draw.chance(50), per_step: false });
    let decided = outcome(Golden::new(&network), &sample, &settings);
    assert_eq!(outcome(fast, &sample, &settings), decided, "{rule}");
    let whole = outcome(Golden::new(&network), &sample, &SampleSettings::new(network.output()));
    assert!(rule != Rule::Certain || decided.class() == whole.class(), "{rule}");
    let pruned = prune(&network, &Plan::fixed()).unwrap();
    let of_pruned = outcome(Golden::new(&pruned), &sample, &SampleSettings::new(pruned.output()));
    assert_eq!((of_pruned.class(), of_pruned.spikes), (whole.class(), whole.spikes), "pruned");
}

/// A network and a sample with silent stretches.
fn drawn_network(draw: &mut Draw) -> (Quantised, Sample) {
    let form = draw.from(0, 3);
    let network = match form {
        0 => random::drawn(draw, 1),
        1 => random::drawn(draw, 3),
        2 => random::drawn_convolutions(draw),
        _ => {
            let plain = random::drawn(draw, 1);
            random::with_kinds(&plain, draw)
        }
    };
    let sample = random::drawn_sample(&network, draw);
    let silent = draw.from(0, 40) as u32;
    let sample = if form == 3 { random::with_values(&sample, draw, silent) } else { sample };
    (network, sample)
}

fn drawn_options(draw: &mut Draw) -> Options {
    Options {
        copies: draw.from(1, 3) as u32,
        strategy: draw.one_of(&[Strategy::Sequential, Strategy::Greedy, Strategy::Multilevel]),
        objective: draw.one_of(&[Objective::Cores, Objective::EnergyChip, Objective::Latency]),
        seed: draw.from(0, 255) as u64,
        place: draw.chance(50),
        effort: Effort::Work(draw.from(0, 1) as u32),
        ..unsearched()
    }
}

/// The checked program; `None` for a network that does not fit.
fn mapped(network: &Quantised, options: &Options, target: &Target) -> Option<Arc<Program>> {
    match compile(network.clone(), target, options) {
        Ok(mapping) => Some(mapping.program),
        Err(CompileError::DoesNotFit(_)) => None,
        Err(error) => panic!("{error}"),
    }
}

/// The outcome without the number that skipping may change.
fn outcome(engine: impl Engine + 'static, sample: &Sample, settings: &SampleSettings) -> Outcome {
    Outcome { skipped_steps: 0, ..Session::new(engine, 1).run(sample, settings, ()) }
}

/// The expressions of a kind, as a person may type them, in lines: updates, the last the condition
/// of a spike. A kind that is read gives what the interpreter gives.
pub fn kind(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let lines: Vec<String> = text.lines().map(|line| format!("{line:?}")).collect();
    let Some((spikes, updates)) = lines.split_last() else { return };
    let source = SourceText::new(
        "kind.ron",
        format!(
            "Network(name: \"kind\", timestep_ms: 1.0, target: \"oheo-gulch\", kinds: [Kind(name: \"Own\", state: \
             [(name: \"v\", bits: 24, overflow: Clip), (name: \"w\", bits: 16, overflow: Wrap)], parameters: \
             [(name: \"a\", range: (-300, 4096), default: 7)], update: [{}], spikes: {spikes}, reset: [\"v = 0\"])], \
             populations: [Input(name: \"in\", shape: [3], message_bits: 8), Own(name: \"own\", shape: [3], a: [-3, 0, \
             4000])], projections: [Dense(from: [\"in\"], to: \"own\", weights: [[2, -40, 254], [8, 0, 6], [-256, 2, \
             2]])], output: \"own\")",
            updates.join(", ")
        ),
    );
    let Ok(file) = NetworkFile::parse(&source) else { return };
    let Ok(model) = Network::new(file, source, Default::default()) else { return };
    let Ok(network) = lower(&model).and_then(|graph| integers(&graph)) else { return };
    let sample = random::with_values(
        &random::drawn_sample(&network, &mut Draw::of_bytes(&[14, 3, 5, 0, 0, 9, 60, 2])),
        &mut Draw::of_bytes(&[1, 200, 3, 90, 7]),
        5,
    );
    let program = compile(network.clone(), &roomy("oheo-gulch"), &unsearched()).unwrap().program;
    let golden = trace(&mut Golden::new(&network), &network, &sample);
    assert_on_machine(&network, &program, &sample, &golden, text);
}

/// A learning rule, as a person may type it: the fields of a `Rule` in RON. What is read is written
/// and read as the same; the machine gives what the interpreter gives, spikes and all columns.
pub fn rule(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let (semantics, fields) = text.split_once('\n').unwrap_or(("Silicon", text));
    let source = SourceText::new(
        "rule.ron",
        format!(
            "Network(name: \"rule\", timestep_ms: 1.0, learning_semantics: {semantics}, populations: [Input(name: \"in\", \
             shape: [3]), Input(name: \"teach\", shape: [2]), Signal(name: \"value\", shape: [1]), Loihi(name: \"out\", \
             shape: [2], vth_mant: 30)], projections: [Dense(name: \"p\", from: [\"in\"], to: \"out\", sign: Mixed, delay: \
             2, weights: [[2, -40, 254], [8, 0, 6]], learning: {fields}), Dense(from: [\"teach\"], to: \"out\", weights: \
             [[254, 0], [0, 254]])], output: \"out\")"
        ),
    );
    let Ok(file) = NetworkFile::parse(&source) else { return };
    let Ok(model) = Network::new(file, source, Default::default()) else { return };
    let Ok(network) = lower(&model).and_then(|graph| integers(&graph)) else { return };
    for learning in &network.parts().rules {
        for variable in Variable::ALL {
            let change = learning.rule.change(variable);
            let again = (!change.products().is_empty()).then(|| parse(&change.to_string()).unwrap());
            assert_eq!(again.unwrap_or_default(), *change, "{text}");
        }
    }
    let sample = random::drawn_sample(&network, &mut Draw::of_bytes(&[14, 3, 5, 0, 0, 9, 60, 2]));
    let program = compile(network.clone(), &roomy("oheo-gulch"), &unsearched()).unwrap().program;
    let image = Image::new(&program, 1).unwrap();
    let (golden, fast) = (&mut Golden::new(&network), &mut Machine::new(&image, Settings::default()));
    assert_eq!(columns(golden, &sample), columns(fast, &sample), "{text}");
}

/// Membranes and the columns of the first rule after each step.
fn columns(engine: &mut impl Engine, sample: &Sample) -> Vec<Vec<i32>> {
    let columns = Variable::ALL.map(Column::Variable).into_iter().chain(Trace::ALL.map(Column::Trace));
    let columns: Vec<Column> = columns.collect();
    engine.begin(sample.steps());
    let mut all = Vec::new();
    for step in 0..sample.steps() {
        engine.step(sample.input(step));
        all.push(vec![engine.v(CompartmentId(0)), engine.v(CompartmentId(1))]);
        all.extend(columns.iter().map(|&column| engine.learned(RuleId(0), column)));
    }
    engine.settle();
    all.extend(columns.iter().map(|&column| engine.learned(RuleId(0), column)));
    all
}

/// A mapping file of a small network: one that is read is refused, or is checked and runs as the
/// interpreter does; its text is read as the same file.
pub fn mapping(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(file) = read(&SourceText::new("mapping.ron", text)) else { return };
    let file = MappingFile { checksum: None, ..file };
    let again = read(&SourceText::new("again.ron", mapping_text(&file).unwrap()));
    assert_eq!(again.unwrap(), file);
    let network = nsim_testing::random_network(3);
    let target = load_target("loihi1-chip").unwrap();
    let options = Options { copies: file.copies.clamp(1, 4), ..unsearched() };
    if let Ok(mapping) = load(network.clone(), &target, &options, &file)
        && options.copies == 1
    {
        let sample = random::sample(&network, 3);
        let golden = trace(&mut Golden::new(&network), &network, &sample);
        assert_on_machine(&network, &mapping.program, &sample, &golden, "mapping");
    }
}
