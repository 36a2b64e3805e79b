//! `nsim agree`: where and why two networks part.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::agree::attribution::attribute;
use crate::agree::ladder::{Ladder, layers};
use crate::agree::trace::{Comparison, Layer, Trace, measured_shift};
use crate::base::diagnostic::Diagnostic;
use crate::base::id::CompartmentId;
use crate::cli::args::conversion::{Conversion, fits};
use crate::cli::args::input::{InputArgs, select};
use crate::cli::args::inputs;
use crate::cli::args::jobs::Refusal;
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::compile::frontend::analytic::{self, Fit};
use crate::compile::frontend::real_and_integers;
use crate::compile::{CompileError, Form, Options, compile};
use crate::desc::stimulus::{InputArg, InputSource};
use crate::error::Error;
use crate::golden::Golden;
use crate::io;
use crate::io::spikes::{PopulationSpikes, read_source};
use crate::ir::graph::{Graph, PopulationKind, ThresholdParameter};
use crate::ir::quantised::{Quantised, Units};
use crate::ir::spikes::Sample;
use crate::machine::{Image, Machine, Settings};
use crate::reference::{self, Model, Reference};
use crate::report::agree::{AgreeReport, LayerRow};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim agree                                             the shipped spike response network against its conversion
  nsim agree container-tactile --input dataset.ron       a network of Loihi neurons against itself in real numbers
  nsim agree model.ron --input s.npy --against golden --require-exact
  nsim agree model.ron --input in.npy --against hidden=h.npy --against out=o.npy --require-exact
  nsim agree --require-class-agreement 0.99 --svg causes.svg";

/// Say where and why a network and what it became part: spikes, potentials, classes, causes
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip-srm")]
    model: String,
    #[command(flatten)]
    input: InputArgs,
    /// What the deployed network is held against: srm (as trained), cuba (current-based neurons in real numbers), golden, or
    /// a file of recorded spikes, [POPULATION=]FILE [default: srm for spike response networks, cuba for others]
    #[arg(long, value_name = "srm|cuba|golden|FILE")]
    against: Vec<String>,
    /// How a spike response network becomes integers
    #[arg(long, value_enum, default_value = "search")]
    conversion: Conversion,
    /// Samples to search on, as --input takes them [default: the scene with another seed, or the first of the input]
    #[arg(long, value_name = "SOURCE")]
    calibrate: Vec<String>,
    /// How many samples to search on
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    calibration_samples: u32,
    /// Compare only so many steps of each sample
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// Say which cause takes what share of the disagreement
    #[arg(long, value_enum, default_value = "on")]
    attribution: Switch,
    /// How many samples to attribute on
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    attribution_samples: u32,
    /// A bar chart of the causes
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// A document whose section `<!-- agree MODEL -->` is replaced; the bar chart goes beside it
    #[arg(long, value_name = "FILE.md")]
    update: Option<PathBuf>,
    /// A target file or the name of a shipped target, onto which the deployed network is mapped
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Exit status 1 below this share of samples with the same class
    #[arg(long, value_name = "SHARE")]
    require_class_agreement: Option<f64>,
    /// Exit status 1 unless every spike agrees
    #[arg(long)]
    require_exact: bool,
}

/// What the deployed network is held against.
enum Against {
    Srm,
    Cuba,
    Golden,
    /// Recorded spikes: a population's samples each.
    Recorded(Vec<(Layer, Vec<PopulationSpikes>)>),
}

impl Against {
    fn name(&self) -> &'static str {
        match self {
            Against::Srm => "srm",
            Against::Cuba => "cuba",
            Against::Golden => "golden",
            Against::Recorded(_) => "recorded spikes",
        }
    }
}

/// Samples that are run and compared at once: bounds what is kept in memory.
const BATCH: usize = 64;

/// The command; the answer is no when a bound that was asked for is missed.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    if let Some(svg) = &args.svg {
        io::write::check_free(svg, context.force)?;
    }
    if args.require_class_agreement.is_some_and(|share| !(0.0..=1.0).contains(&share)) {
        return Err(Error::Usage("--require-class-agreement is a share between 0 and 1".to_string()));
    }
    let network = io::model::load_model(&args.model)?;
    let scene = network.file().scene.clone();
    let (graph, analytic) = real_and_integers(&network)?;
    Form::require_written("nsim agree", &analytic, 1)?;
    let stimulus = inputs::stimulus(&analytic, &args.input.input, scene.as_deref(), args.input.seed)?;
    let samples = select(&stimulus.samples, &args.input)?;
    let against = against(args, &graph, &analytic)?;

    let wanted = args.calibration_samples as usize;
    let scene = scene.as_deref();
    let (fits, found) =
        fits(args.conversion, &args.calibrate, wanted, &args.input, &graph, &analytic, scene, &samples)?;
    let ladder = Ladder::new(&graph, &fits)?;
    let target = io::target::load_target(&args.target)?;
    let compiled = match compile(ladder.deployed().clone(), &target, &Options::default()) {
        Ok(compiled) => compiled,
        Err(CompileError::DoesNotFit(reasons)) => {
            return Refusal::new(&args.model, target, reasons).say(crate::report::agree::nothing(), context);
        }
        Err(other) => return Err(other.into()),
    };
    let attributed = matches!(against, Against::Srm | Against::Cuba) && matches!(args.attribution, Switch::On);
    if args.svg.is_some() && !attributed {
        let message = "--svg draws the causes of disagreement, which --against srm or cuba has, with --attribution on";
        return Err(Error::Usage(message.to_string()));
    }
    let outcome = compare(args, &graph, &fits, &ladder, &compiled.program, &against, &samples, context)?;
    let attribution = match attributed {
        true => {
            let some = &samples[..samples.len().min(args.attribution_samples as usize)];
            Some(attribute(&ladder, &output_layer(ladder.deployed()), some))
        }
        false => None,
    };
    if let (Some(path), Some(attribution)) = (&args.svg, &attribution) {
        let svg = crate::report::agree::bars(&args.model, attribution);
        io::write::file(path, context.force, |out| out.write_all(svg.as_bytes()))?;
    }
    let report = AgreeReport {
        model: &graph.facts().name,
        against: against.name(),
        input: &stimulus.origin,
        seed: stimulus.seed,
        samples: samples.len(),
        same_class: outcome.same_class,
        accuracy: outcome.accuracy,
        layers: &outcome.rows,
        found: found.as_ref(),
        fits: &named(&graph, &fits),
        attribution: attribution.as_ref(),
        attribution_samples: samples.len().min(args.attribution_samples as usize),
    };
    if let (Some(path), Some(attribution)) = (&args.update, &attribution) {
        let name = &graph.facts().name;
        let (mark, picture) = (format!("agree {name}"), format!("agreement-{name}.svg"));
        let svg = crate::report::agree::bars(name, attribution);
        output::update_section(path, &mark, &report.markdown(&picture), &picture, &svg, context)?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    let exact = outcome.rows.iter().all(|row| row.comparison.first_divergence.is_none());
    let enough =
        args.require_class_agreement.is_none_or(|share| report.class_agreement().is_some_and(|is| is >= share));
    Ok(if enough && (exact || !args.require_exact) { Answer::Yes } else { Answer::No })
}

fn named(graph: &Graph, fits: &[Option<Fit>]) -> Vec<(String, Fit)> {
    let each = graph.populations().zip(fits);
    each.filter_map(|((_, population), fit)| Some((population.name.clone(), fit.clone()?))).collect()
}

fn output_layer(network: &Quantised) -> Layer {
    let output = &network.populations()[network.parts().output];
    Layer {
        name: output.name.clone(),
        first: output.first_compartment().map_or(0, |first| first.0),
        count: output.shape.len(),
    }
}

fn against(args: &Args, graph: &Graph, network: &Quantised) -> Result<Against, Error> {
    let word = match args.against.as_slice() {
        [] if graph.has_srm() => "srm",
        [] => "cuba",
        [word] => word,
        _ => "",
    };
    match word {
        "srm" if graph.has_srm() => return Ok(Against::Srm),
        "srm" => {
            let message = format!("{} has no spike response neurons", graph.facts().name);
            return Err(Error::Usage(format!("--against srm: {message}; use cuba or golden")));
        }
        "cuba" => return Ok(Against::Cuba),
        "golden" => return Ok(Against::Golden),
        _ => {}
    }
    let layers = layers(network);
    let recorded = args.against.iter().map(|text| {
        let argument = match InputArg::parse(text)? {
            InputArg { population: Some(name), .. }
                if Path::new(text).exists() && !layers.iter().any(|l| l.name == name) =>
            {
                InputArg { population: None, source: InputSource::Path(text.into()) }
            }
            argument => argument,
        };
        let InputSource::Path(path) = &argument.source else {
            return Err(Error::Usage(format!("--against {text}: a scene is an input, not a recording")));
        };
        let name = argument.population.unwrap_or_else(|| output_layer(network).name);
        let layer = layers.iter().find(|layer| layer.name == name).ok_or_else(|| {
            let names: Vec<&str> = layers.iter().map(|layer| layer.name.as_str()).collect();
            Error::Usage(format!("--against {text}: populations with compartments are: {}", names.join(", ")))
        })?;
        Ok((layer.clone(), read_source(path, u64::from(layer.count))?))
    });
    Ok(Against::Recorded(recorded.collect::<Result<_, Error>>()?))
}

struct Compared {
    rows: Vec<LayerRow>,
    /// Samples of the same class; none when no classes were recorded.
    same_class: Option<usize>,
    accuracy: Option<(f64, f64)>,
}

/// The thresholds of all compartments in register units.
fn thresholds(network: &Quantised) -> Vec<f64> {
    let of = |population: &crate::ir::quantised::Population| match &population.units {
        Units::Loihi { neurons, .. } => {
            (0..population.shape.len()).map(|i| f64::from(neurons.vth.get(i).get().max(1)) * 64.0).collect()
        }
        Units::Input(_) => Vec::new(),
    };
    network.populations().iter().flat_map(of).collect()
}

/// The thresholds of all neurons of a network in real numbers, in its own units.
fn real_thresholds(graph: &Graph) -> Vec<f64> {
    let of = |population: &crate::ir::graph::Population| -> Vec<f64> {
        let count = population.shape.len();
        match &population.kind {
            PopulationKind::Input => Vec::new(),
            PopulationKind::Srm(srm) => vec![srm.theta; count as usize],
            PopulationKind::Loihi(p) => match &p.threshold {
                ThresholdParameter::Real(values) => (0..count).map(|i| values.each.get(i)).collect(),
                ThresholdParameter::Mantissa(values) => {
                    (0..count).map(|i| values.each.get(i).max(1.0) * 64.0).collect()
                }
            },
        }
    };
    graph.populations().flat_map(|(_, population)| of(population)).collect()
}

#[allow(clippy::too_many_arguments)]
fn compare(
    args: &Args,
    graph: &Graph,
    fits: &[Option<Fit>],
    ladder: &Ladder,
    program: &crate::ir::program::Program,
    against: &Against,
    samples: &[&Sample],
    context: Context,
) -> Result<Compared, Error> {
    let network = ladder.deployed();
    let (compartments, output) = (network.compartments(), output_layer(network));
    let integer_thresholds = thresholds(network);
    let real = match against {
        Against::Srm => Some(graph.clone()),
        Against::Cuba => Some(analytic::with_fits(graph, fits)),
        Against::Golden | Against::Recorded(_) => None,
    };
    let model =
        real.as_ref().map(|real| (Model::<f64>::new(real, reference::Options::default()), real_thresholds(real)));
    let image = Image::new(program, 1).map_err(|e| Diagnostic::new("run.too-large", e.to_string()))?;
    let compared: Vec<Layer> = match against {
        Against::Recorded(recorded) => recorded.iter().map(|(layer, _)| layer.clone()).collect(),
        _ => layers(network),
    };
    if let Against::Recorded(recorded) = against {
        for (layer, each) in recorded {
            if each.len() != samples.len() {
                let message =
                    format!("'{}' was recorded in {} samples, the input has {}", layer.name, each.len(), samples.len());
                return Err(Diagnostic::new("agree.samples", message).help("choose samples with --samples").into());
            }
        }
    }
    let first_trace = |index: usize, sample: &Sample| match against {
        Against::Srm | Against::Cuba => match &model {
            Some((model, thresholds)) => {
                let mut engine = Reference::new(model);
                Trace::record(&mut engine, sample, compartments, |engine, c| {
                    engine.potential(c) / thresholds[c.0 as usize]
                })
            }
            None => Trace::default(),
        },
        Against::Golden => {
            let mut engine = Golden::new(network);
            Trace::record(&mut engine, sample, compartments, |engine, c| relative(engine, c, &integer_thresholds))
        }
        Against::Recorded(recorded) => {
            let mut trace = Trace {
                steps: sample.steps(),
                trains: vec![Vec::new(); compartments as usize],
                potentials: Vec::new(),
            };
            for (layer, each) in recorded {
                trace.steps = trace.steps.min(each[index].steps);
                let mut events = each[index].events.clone();
                events.sort_unstable();
                events.dedup();
                let spikes = events.into_iter().filter(|event| event.1 < layer.count);
                spikes.for_each(|(step, neuron)| trace.trains[(layer.first + neuron) as usize].push(step));
            }
            trace
        }
    };
    let limit = args.steps.unwrap_or(u32::MAX);
    let bar = output::progress(context, samples.len() as u64, "samples");
    let pair = |(index, sample): (usize, &&Sample)| {
        let mut machine = Machine::new(&image, Settings { skip: true, per_step: false });
        let second = Trace::record(&mut machine, sample, compartments, |m, c| relative(m, c, &integer_thresholds));
        let first = first_trace(index, sample).until(limit);
        bar.inc(1);
        (first, second.until(limit))
    };
    let mut comparisons: Vec<(Comparison, i32)> = Vec::new();
    let (mut same, mut right) = (0usize, (0usize, 0usize));
    for (batch, some) in samples.chunks(BATCH).enumerate() {
        let indexed: Vec<(usize, &&Sample)> = some.iter().enumerate().map(|(i, s)| (batch * BATCH + i, s)).collect();
        let traces: Vec<(Trace, Trace)> = indexed.into_par_iter().map(pair).collect();
        if comparisons.is_empty() {
            let pairs: Vec<(&Trace, &Trace)> = traces.iter().map(|(a, b)| (a, b)).collect();
            let shift = |layer: &Layer| match against {
                Against::Srm => -1,
                Against::Cuba | Against::Golden => 0,
                Against::Recorded(_) => measured_shift(layer, &pairs),
            };
            comparisons = compared.iter().map(|layer| (Comparison::default(), shift(layer))).collect();
        }
        for (i, ((a, b), sample)) in traces.iter().zip(some).enumerate() {
            for (layer, (comparison, shift)) in compared.iter().zip(&mut comparisons) {
                comparison.add(batch * BATCH + i, layer, a, b, *shift);
            }
            let (class_a, class_b) = (a.class(&output), b.class(&output));
            same += usize::from(class_a == class_b);
            right.0 += usize::from(class_a == sample.label());
            right.1 += usize::from(class_b == sample.label());
        }
    }
    bar.finish_and_clear();
    let known = compared.contains(&output);
    let labelled = known && samples.iter().all(|sample| sample.label().is_some());
    let share = |count: usize| count as f64 / samples.len().max(1) as f64;
    let rows = compared.into_iter().zip(comparisons);
    Ok(Compared {
        rows: rows.map(|(layer, (comparison, shift))| LayerRow { name: layer.name, shift, comparison }).collect(),
        same_class: known.then_some(same),
        accuracy: labelled.then(|| (share(right.0), share(right.1))),
    })
}

fn relative<E: crate::ir::spikes::Engine>(engine: &E, compartment: CompartmentId, thresholds: &[f64]) -> f64 {
    f64::from(engine.v(compartment)) / thresholds[compartment.0 as usize]
}
