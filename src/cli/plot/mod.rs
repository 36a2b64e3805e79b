//! `nsim plot`: one picture, of a run of a model on an input, of a mapping, or of a saved result.
//!
//! Input: the kind of picture; a model with the options of `nsim energy`, or a JSON result of a
//! command. Output: an SVG, PNG or PDF file, by its name. Of a run the first selected sample is
//! drawn.
//!
//! Errors: a model for a picture of results alone; a result without the data of the picture.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::Value;

use crate::cli::args::{jobs, saved};
use crate::cli::context::{Answer, Context, Format, refuse_if};
use crate::cli::energy::args::CostArgs;
use crate::cli::energy::evaluate::evaluate;
use crate::cli::energy::workload::workload;
use crate::cli::output;
use crate::cli::process::progress;
use nsim_compile::DEFAULT_RATE;
use nsim_energy::workload::Workload;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CompartmentId, PopulationId};
use nsim_ir::base::names::fits_pattern;
use nsim_ir::firing_rates::Rates;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_report::charts::picture::FILE;
use nsim_report::charts::sample::{raster, traced, traces};
use nsim_report::charts::weights::weights;
use nsim_report::charts::{board, results};
use nsim_session::Quantity;
use nsim_session::error::Error;
use nsim_session::obtain::EngineKind;
use nsim_session::priced::MeteredMapping;
use nsim_session::weights::WeightHistory;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim plot raster -o raster.svg                        spikes of inputs and populations in one sample
  nsim plot raster model.ron --input s.npy --samples 3..4 --probe 'hid*' -o raster.svg
  nsim plot voltage model.ron --probe 'out[2]' --probe hidden -o voltage.svg
  nsim plot messages pilotnet.ron --input frames.npy --probe layer9 -o out.svg  its messages, step by step
  nsim plot weights model.ron --probe stdp -o w.svg     weights of a rule over time, before and after
  nsim plot energy --copies 32 -o energy.svg            energy of a timestep by part
  nsim plot time result.json -o time.svg                time of a timestep by part, from a saved result
  nsim plot map model.ron --copies 8 -o map.svg         cores on their chips, and the load of links
  nsim agree --format json > a.json && nsim plot agreement a.json -o causes.svg
  nsim map --pareto p.svg --format json > m.json && nsim plot pareto m.json -o pareto.svg";

/// Kinds of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum PlotKind {
    /// Spikes of a sample over time, a panel for each population
    Raster,
    /// Potentials of compartments over time
    Voltage,
    /// Integers that compartments send over time
    Messages,
    /// Weights of a learning rule over time, each before and after, and the traces of one synapse
    Weights,
    /// Power, time and energy of a timestep on all hardware
    Hardware,
    /// Energy of a timestep by part
    Energy,
    /// Time of a timestep by part
    Time,
    /// Cores on their chips, their contents, and the traffic of links
    Map,
    /// Results of bench pareto or map --pareto, and their front
    Pareto,
    /// A result of agree: the causes of disagreement
    Agreement,
}

/// Schemas of results, the command that prints one, and the function that draws one.
type ResultPlot = (&'static [&'static str], &'static str, fn(&Value) -> Option<String>);

impl PlotKind {
    /// Name of the kind on the command line.
    fn name(self) -> String {
        self.to_possible_value().map_or(String::new(), |value| value.get_name().to_string())
    }

    /// Drawing from a result; none for a picture that needs a run.
    fn result_plot(self) -> Option<ResultPlot> {
        Some(match self {
            PlotKind::Raster | PlotKind::Voltage | PlotKind::Messages | PlotKind::Weights | PlotKind::Map => {
                return None;
            }
            PlotKind::Hardware => (&["nsim.energy/1"], "nsim energy", results::hardware),
            PlotKind::Energy => (&["nsim.energy/1"], "nsim energy", results::energy),
            PlotKind::Time => (&["nsim.energy/1"], "nsim energy", results::time),
            PlotKind::Pareto => (&["nsim.bench/1", "nsim.map/1"], "nsim bench pareto", results::pareto),
            PlotKind::Agreement => (&["nsim.agree/1"], "nsim agree", results::agreement),
        })
    }
}

/// Draw a picture of a run, of a mapping, or of a saved result
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Kind of picture
    #[arg(value_enum, value_name = "WHAT")]
    what: PlotKind,
    #[command(flatten)]
    cost: CostArgs,
    /// Populations to draw, by name or pattern; for voltage and messages also single compartments,
    /// such as 'out[2]' [default: all; of compartments those that spike most]; for weights the
    /// name of a rule [default: the first]
    #[arg(long, value_name = "POP")]
    probe: Vec<String>,
    /// The picture; its name gives the format: SVG in every build of nsim, PNG and PDF with the
    /// feature pictures
    #[arg(short, long, value_name = FILE)]
    output: PathBuf,
}

/// Most compartments of a population that are drawn if none is named.
const MOST_OF_POPULATION: usize = 3;
/// Most compartments of a picture.
const MOST_OF_PICTURE: usize = 11;

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    refuse_if(context.format != Format::Text, "nsim plot writes a picture and does not support --format")?;
    let taken = output::check_files(None, [&args.output], context)?;
    let (what, name) = (args.what, args.what.name());
    let has_probes = matches!(what, PlotKind::Raster | PlotKind::Voltage | PlotKind::Messages | PlotKind::Weights);
    let refusal = format!("nsim plot {name} does not support --probe; raster, voltage, messages and weights do");
    refuse_if(!args.probe.is_empty() && !has_probes, refusal)?;
    let (model, result_plot) = (&args.cost.job.model, what.result_plot());
    if saved::is_result(model) {
        let Some((schemas, command, draw)) = result_plot else {
            return Err(Error::Usage(format!("nsim plot {name} runs a model: {model} is a result")));
        };
        let help = format!("give JSON that {command} printed with --format json");
        let (result, _) = saved::read(Path::new(model), schemas, &help)?;
        let missing = || {
            let message = format!("has no data for {name}");
            Diagnostic::new("report.result", message).in_file(Path::new(model)).help(help.as_str())
        };
        return write(args, &draw(&result).ok_or_else(missing)?, taken, context);
    }
    match (what, result_plot) {
        (_, None) => mapped(args, taken, context),
        (PlotKind::Pareto | PlotKind::Agreement, Some((_, command, _))) => Err(Error::Usage(format!(
            "nsim plot {name} draws a result: {command} {model} --format json > FILE.json, then give that file"
        ))),
        (_, Some((.., draw))) => evaluate(&args.cost, None, context, |_, evaluated| {
            let picture = draw(&evaluated.energy.json());
            let picture = picture.ok_or_else(|| Error::Usage(format!("nsim plot {name}: the run has no timesteps")))?;
            write(args, &picture, taken, context)
        }),
    }
}

/// A picture of a mapping or of a sample on it.
fn mapped(args: &Args, taken: bool, context: Context) -> Result<Answer, Error> {
    let cost = &args.cost;
    let copies = if args.what == PlotKind::Map { cost.copies } else { cost.copies.or(Some(1)) };
    let populations = if args.what == PlotKind::Weights { &[][..] } else { &args.probe };
    let names: Vec<&str> = populations.iter().map(|text| pattern(text).0).collect();
    let job = match jobs::prepare(&cost.job, EngineKind::Mapped, copies, &names)? {
        Ok(job) => job,
        Err(refusal) => return refusal.print(Value::Null, context),
    };
    if args.what == PlotKind::Map {
        let Some((compiled, target)) = job.mapped() else {
            return Err(Error::Fault("a map needs a mapped job".to_string()));
        };
        let links = compiled.links_at(&Rates::assumed(DEFAULT_RATE));
        return write(args, &board::svg(compiled, target, &links), taken, context);
    }
    let workload = workload(&job, None, &cost.input)?;
    let network = &workload.compiled.one;
    let samples = workload.samples();
    let Some(sample) = samples.first() else {
        return Err(Error::Usage("there is no sample to draw".to_string()));
    };
    let metered = MeteredMapping::new(workload.compiled);
    let quantity = if args.what == PlotKind::Messages { Quantity::Message } else { Quantity::Potential };
    let drawn = |ids: &[CompartmentId]| {
        let (settings, _) = metered.offline(workload.target)?;
        workload.timeline(settings, sample, (ids, quantity))
    };
    let number = cost.input.samples.as_ref().map_or(0, |range| range.start);
    let label = sample.label().map_or(String::new(), |label| {
        let name = network.parts().classes.get(label as usize).cloned().unwrap_or_else(|| label.to_string());
        format!(", class {name}")
    });
    let title = format!("{}, sample {number}{label}", network.parts().name);
    if args.what == PlotKind::Weights {
        return write(args, &weights_of(args, &workload, sample, &title)?, taken, context);
    }
    let timeline = progress::with_bar(context, 1, "sample", |_| drawn(&[]))?;
    let populations = chosen(network, &args.probe, args.what)?;
    if args.what == PlotKind::Raster {
        let shown: Vec<PopulationId> = populations.into_iter().map(|(id, _)| id).collect();
        return write(args, &raster(&title, network, &timeline, &shown), taken, context);
    }
    let mut counts = vec![0u32; network.compartments() as usize];
    for (population, raster) in network.populations().iter().zip(&timeline.rasters) {
        if let Some(first) = population.first_compartment() {
            raster.spikes.iter().for_each(|&(_, unit)| counts[(first.0 + unit) as usize] += 1);
        }
    }
    let wanted = populations.into_iter().map(|(id, named)| (id, named, MOST_OF_POPULATION));
    let spikes = |id: CompartmentId| u64::from(counts[id.0 as usize]);
    let (ids, traced) = traced(network, wanted, quantity, spikes, MOST_OF_PICTURE);
    refuse_if(traced.is_empty(), "no neuron of these populations has a potential: plot messages or raster instead")?;
    let timeline = progress::with_bar(context, 1, "sample", |_| drawn(&ids))?;
    write(args, &traces(&title, network, &timeline, &traced, quantity), taken, context)
}

/// The weights of the rule that is probed, or of the first, over a sample.
fn weights_of(args: &Args, workload: &Workload<'_>, sample: &Sample, title: &str) -> Result<String, Error> {
    let (network, compiled) = (&workload.compiled.one, workload.compiled);
    let rules = &network.parts().rules;
    let named = |name: &str| args.probe.iter().all(|probe| fits_pattern(probe, name));
    let names: Vec<&str> = rules.iter().map(|learning| learning.name.as_str()).collect();
    let Some((rule, learning)) = rules.enumerate().find(|(_, learning)| named(&learning.name)) else {
        let known = if names.is_empty() { "none".to_string() } else { names.join(", ") };
        return Err(Error::Usage(format!("nsim plot weights draws a learning rule; there are: {known}")));
    };
    let draws = &workload.learning.draws;
    let history = WeightHistory::new(&compiled.program, network, draws, rule, sample)?;
    Ok(weights(&format!("{title}: weights of {}", learning.name), &history))
}

/// Pattern of a probe, and the index of its compartment, if any.
fn pattern(text: &str) -> (&str, Option<&str>) {
    match text.strip_suffix(']').and_then(|text| text.rsplit_once('[')) {
        Some((pattern, index)) => (pattern, Some(index)),
        None => (text, None),
    }
}

/// Populations that probes name, each with its named compartment, if any; all without probes.
fn chosen(network: &Quantised, probes: &[String], what: PlotKind) -> Result<Vec<(PopulationId, Option<u32>)>, Error> {
    let fits = |id: PopulationId| what == PlotKind::Raster || network.populations()[id].first_compartment().is_some();
    let all: Vec<PopulationId> = network.populations().ids().filter(|&id| fits(id)).collect();
    if probes.is_empty() {
        return Ok(all.into_iter().map(|id| (id, None)).collect());
    }
    let mut traced = Vec::new();
    for text in probes {
        let (named, index) = pattern(text);
        let before = traced.len();
        for &id in all.iter().filter(|&&id| fits_pattern(named, &network.populations()[id].name)) {
            let index = match index {
                None => None,
                Some(index) if what != PlotKind::Raster => {
                    let shown = index.parse().ok().and_then(|index| network.index_after_pruning(id, index));
                    let units = network.units_before_pruning(id);
                    let name = &network.populations()[id].name;
                    Some(shown.ok_or_else(|| {
                        Error::Usage(format!("--probe {text}: '{name}' has compartments 0 to {}", units.max(1) - 1))
                    })?)
                }
                Some(_) => return Err(Error::Usage(format!("--probe {text}: a raster shows whole populations"))),
            };
            traced.push((id, index));
        }
        if traced.len() == before {
            let names: Vec<&str> = all.iter().map(|&id| network.populations()[id].name.as_str()).collect();
            return Err(Error::Usage(format!("--probe {text}: there are {}", names.join(", "))));
        }
    }
    let first = |at: usize| traced[..at].iter().all(|other| *other != traced[at]);
    Ok((0..traced.len()).filter(|&at| first(at)).map(|at| traced[at]).collect())
}

fn write(args: &Args, svg: &str, taken: bool, context: Context) -> Result<Answer, Error> {
    output::write_picture(&args.output, svg, context)?;
    if !taken {
        progress::print(&format!("{}\n", args.output.display()))?;
    }
    Ok(Answer::Yes)
}
