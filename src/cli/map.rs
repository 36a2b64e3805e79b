//! `nsim map`: compiles a model for a target and says how it fits, or every reason why it does not.

use std::path::PathBuf;

use crate::cli::args::jobs::JobArgs;
use crate::cli::args::values::one_of;
use crate::cli::context::{Answer, Context};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_compile::explore;
use nsim_compile::explore::remedy::{self, Refused, Remedy};
use nsim_compile::{
    CompileError, CopyPlacement, DEFAULT_RATE, Effort, Mapping, Objective, Options, Reason, Strategy, refuse_large,
};
use nsim_files as io;
use nsim_files::changes::{Change, with_changes};
use nsim_files::shipped;
use nsim_files::warnings::show;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_report::charts::board;
use nsim_report::charts::picture::FILE;
use nsim_report::map::{MapOutcome, MapRequest, MapResult};
use nsim_session::error::{Error, Result};
use nsim_session::inputs;
use nsim_session::obtain::{self, MappingSettings, Request};
use nsim_session::samples::firing_rates;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim map                                          the shipped network on a board of 32 chips
  nsim map model.ron --target loihi1-chip           on one chip, or every reason why not
  nsim map --copies 32                              32 copies, each on a chip of its own
  nsim map --copies 32 --deployment packed -o packed.ron   on as few cores as they fit; save the mapping
  nsim map mnist.ron --cores-of h1=50,h2=64          cores of 50 and 64 neurons, as a board's log has them
  nsim map --mapping packed.ron                     check and use a saved mapping
  nsim map --prune static                           without parts that cannot change an output, which are listed
  nsim map wide.ron --relays                        with relays that forward spikes where output axons are too few
  nsim map --objective latency --profile recordings.npy   short timesteps at the firing rates of these recordings
  nsim map --pareto front.svg                       cores, energy and time of several mappings, with the Pareto front
  nsim map --copies 32 --plot board.svg             a picture of the chips in use
  nsim map model.ron --format json                  for scripts";

/// Parses seconds, at most a day, and returns milliseconds.
fn milliseconds(typed: &str) -> Result<u32, String> {
    let seconds: f64 = typed.parse().map_err(|_| "is not a number of seconds".to_string())?;
    match (0.0..=86_400.0).contains(&seconds) {
        true => Ok((seconds * 1e3).ceil() as u32),
        false => Err("is not between 0 and 86400 seconds".to_string()),
    }
}

/// Arguments of `nsim map`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct MapArgs {
    #[command(flatten)]
    pub job: JobArgs,
    /// Copies of the model; 1 unless a mapping says otherwise
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub copies: Option<u32>,
    /// Placement of copies: each on chips of its own and then more on each chip, or on as few cores
    /// as they fit
    #[arg(
        long, default_value = "spread",
        value_parser = one_of(&CopyPlacement::ALL, CopyPlacement::name), conflicts_with = "mapping"
    )]
    pub deployment: CopyPlacement,
    /// Objective: cores, energy or latency
    #[arg(long, default_value = "cores", value_parser = one_of(&Objective::ALL, Objective::name))]
    pub objective: Objective,
    /// Assignment of compartments to cores: sequential, greedy or multilevel
    #[arg(
        help_heading = "Mapping", long, default_value = "multilevel",
        value_parser = one_of(&Strategy::ALL, Strategy::name), conflicts_with = "mapping"
    )]
    pub strategy: Strategy,
    /// Keep cores in the order of the partition instead of placing communicating cores close
    /// together
    #[arg(help_heading = "Mapping", long, conflicts_with = "mapping")]
    pub unplaced: bool,
    /// Wall-clock seconds that mapping may take, such as 0.5; 0 for the quickest mapping [default:
    /// a fixed amount of work, so that the result is the same on any machine]
    #[arg(help_heading = "Mapping", long, value_name = "S", value_parser = milliseconds)]
    pub time_budget: Option<u32>,
    /// Seed of randomised strategies
    #[arg(help_heading = "Mapping", long, default_value_t = 0, conflicts_with = "mapping")]
    pub seed: u64,
    /// Input spikes from which firing rates are measured, as --input of nsim run takes them;
    /// `scene` for the model's own [default: one assumed rate for all]
    #[arg(help_heading = "Mapping", long, value_name = "SOURCE")]
    pub profile: Vec<String>,
    /// Compare several mappings and draw cores, energy and step time, with the Pareto front
    #[arg(long, value_name = FILE, conflicts_with_all = ["mapping", "cores_of"])]
    pub pareto: Option<PathBuf>,
    /// Draw the cores on their chips, their contents, and the traffic of the links
    #[arg(long, visible_alias = "svg", value_name = FILE)]
    pub plot: Option<PathBuf>,
    /// Where to save the mapping
    #[arg(short, long)]
    pub output: Option<PathBuf>,
}

/// A network that does not fit is an answer, not an error.
pub fn run(args: &MapArgs, context: Context) -> Result<Answer> {
    let pictures = [&args.plot, &args.pareto].into_iter().flatten();
    let taken = output::check_files(&args.output, pictures, context)?;
    let network = args.job.reading.load(&args.job.model)?;
    let request = Request { copies: args.copies, options: options(args), ..args.job.request(&network) };
    let (front, settings) = match obtain::prepare_mapping(&request) {
        Err(Error::DoesNotFit(reasons)) => return print_refusal(args, &request, &reasons, context),
        begun => begun?,
    };
    show("", &front.quantised().parts().warnings);
    let MappingSettings { target, options, .. } = &settings;
    let tries_remedies = settings.saved.is_none() && !front.in_boxes(options.copies) && args.job.cores_of.is_empty();
    let (one, relays) = (front.quantised().clone(), front.relays().cloned());
    if !args.profile.is_empty() {
        refuse_large("--profile", &one, options.copies)?;
    }
    let rates = match args.profile.as_slice() {
        [] => Rates::assumed(DEFAULT_RATE),
        inputs => profile(&one, inputs, network.file().scene.as_deref())?,
    };
    let mut candidates = Vec::new();
    if args.pareto.is_some() {
        let _busy = progress::stage("mapping in several ways");
        candidates = explore::candidates(&front, target, options, &rates).unwrap_or_default();
    }
    let busy = progress::stage(if settings.saved.is_some() { "checking the mapping" } else { "mapping" });
    let mapped = match settings.mapped(front, &rates) {
        Ok(mapped) => Ok(mapped),
        Err(CompileError::DoesNotFit(reasons)) => Err(reasons),
        Err(other) => return Err(other.into()),
    };
    drop(busy);
    let remedies = match &mapped {
        Err(reasons) if tries_remedies => remedies(args, &request, &settings, &one, reasons),
        _ => Vec::new(),
    };
    let pruned = mapped.as_ref().map_or(one.pruned(), |mapped| mapped.one.pruned()).cloned();
    let question = MapRequest {
        model: &network.file().name,
        target,
        options,
        pruned: pruned.as_deref().map_or(&[], |pruned| &pruned.rows),
        remedies: &remedies,
        relays: relays.as_ref(),
        found: &candidates,
    };
    let outcome = match &mapped {
        Ok(mapped) => {
            let traffic = mapped.traffic();
            MapOutcome::Fits(mapped, traffic, mapped.score(&traffic, target)?)
        }
        Err(reasons) => MapOutcome::DoesNotFit(reasons),
    };
    let result = MapResult::new(question, outcome);
    if let Ok(mapped) = &mapped {
        write_files(args, mapped, &result, target, context)?;
    }
    // A file on stdout replaces the result.
    if !taken || mapped.is_err() {
        output::print(context.format, || result.text(), || result.json(), || result.csv())?;
    }
    Ok(if mapped.is_ok() { Answer::Yes } else { Answer::No })
}

/// Prints the reasons why a network does not fit, which were found before it was mapped.
fn print_refusal(args: &MapArgs, request: &Request<'_>, reasons: &[Reason], context: Context) -> Result<Answer> {
    let file = request.network.file();
    let target = io::target::load_target(file.target_or_usual(args.job.target.as_deref()))?;
    let options = Options { copies: args.copies.unwrap_or(1), ..request.options };
    let (model, pruned, remedies, relays, found) = (&file.name, &[], &[], None, &[]);
    let question = MapRequest { model, target: &target, options: &options, pruned, remedies, relays, found };
    let result = MapResult::new(question, MapOutcome::DoesNotFit(reasons));
    output::print(context.format, || result.text(), || result.json(), || result.csv())?;
    Ok(Answer::No)
}

/// Changes of model, mapping or target that make the network fit, each tried.
fn remedies(
    args: &MapArgs,
    request: &Request<'_>,
    settings: &MappingSettings,
    one: &Quantised,
    reasons: &[Reason],
) -> Vec<Remedy> {
    let MappingSettings { target, options, .. } = settings;
    let projections = request.network.file().projections.iter();
    let weight_bits: Vec<_> = projections.map(|p| (p.to.clone(), p.weight_bits)).collect();
    let refused = Refused { one, target, options, reasons, weight_bits: &weight_bits };
    // Reads model and target again with the proposed changes applied.
    let changed = |changes: &[String]| {
        let changes: Vec<Change> = changes.iter().map(|typed| Change::parse(typed)).collect::<Result<_, _>>().ok()?;
        with_changes(&changes, || {
            let network = args.job.reading.load(&args.job.model).ok()?;
            let (front, settings) = obtain::prepare_mapping(&Request { network: &network, ..*request }).ok()?;
            Some((front, settings.target))
        })
    };
    let mut remedies = remedy::remedies(refused, &larger(target), &changed);
    // A pruned network cannot have relays, so neither can be proposed.
    remedies.retain(|remedy| !args.job.anew.relays || !["prune", "relays"].contains(&remedy.kind));
    remedies
}

/// Writes the mapping and the pictures that were asked for.
fn write_files(
    args: &MapArgs,
    mapped: &Mapping,
    result: &MapResult<'_>,
    target: &Target,
    context: Context,
) -> Result<()> {
    if let Some(output) = &args.output {
        io::write::text(output, context.force, &io::mapping::mapping_text(&mapped.mapping_file())?)?;
    }
    if let Some(path) = &args.plot {
        output::write_picture(path, &board::svg(mapped, target, &mapped.links()), context)?;
    }
    if let Some(path) = &args.pareto {
        output::write_picture(path, &result.pareto_svg(), context)?;
    }
    Ok(())
}

/// Most samples of a profile run.
const MOST_SAMPLES: usize = 64;

/// Firing rates of sources over samples, by the golden interpreter, which needs no mapping.
fn profile(network: &Quantised, sources: &[String], scene: Option<&str>) -> Result<Rates> {
    let sources: Vec<String> = match sources {
        [one] if one == "scene" && scene.is_none() => {
            let message = format!("model {} has no scene, so --profile scene has no rates", network.parts().name);
            let help = "give --profile an input: a file, or scene:noise?rate=0.1 for noise";
            return Err(Diagnostic::new("map.profile", message).help(help).into());
        }
        [one] if one == "scene" => Vec::new(),
        given => given.to_vec(),
    };
    let stimulus = inputs::stimulus(network, &sources, scene, None)?;
    Ok(firing_rates(network, stimulus.samples.iter().take(MOST_SAMPLES)))
}

/// Shipped targets with the neuron kinds and limits of this one and with more cores, ascending.
/// Targets to which the `--set` of this command cannot be applied are skipped.
fn larger(target: &Target) -> Vec<Target> {
    let boards = shipped::TARGETS.iter().filter_map(|board| io::target::load_target(board.name).ok());
    let mut boards: Vec<Target> = boards
        .filter(|board| board.cores() > target.cores() && board.limits() == target.limits())
        .filter(|board| board.chip().neuron_kinds == target.chip().neuron_kinds)
        .collect();
    boards.sort_by_key(Target::cores);
    boards
}

/// Options of the compiler.
fn options(args: &MapArgs) -> Options {
    Options {
        placement: args.deployment,
        strategy: args.strategy,
        objective: args.objective,
        seed: args.seed,
        place: !args.unplaced,
        effort: args.time_budget.map_or(Options::default().effort, Effort::within_ms),
        ..Options::default()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use crate::cli::map::*;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        map: MapArgs,
    }

    fn typed(words: &[&str]) -> Result<MapArgs, clap::Error> {
        Typed::try_parse_from([&["map"], words].concat()).map(|typed| typed.map)
    }

    #[test]
    fn what_is_typed_becomes_options() {
        let args = typed(&[]).unwrap();
        assert_eq!((args.job.model.as_str(), args.job.target.as_deref()), ("vtsnn-slip", None));
        assert_eq!(options(&args), Options::default());
        let args = typed(&["m.ron", "--objective", "latency", "--seed", "5"]).unwrap();
        let expected = Options { objective: Objective::Latency, seed: 5, ..Options::default() };
        assert_eq!(options(&args), expected);
        for wrong in [["--copies", "0"], ["--objective", "speed"], ["--strategy", "best"], ["--seed", "x"]] {
            assert!(typed(&wrong).is_err(), "{wrong:?}");
        }
        let said = typed(&["--objective", "speed"]).unwrap_err().to_string();
        assert!(said.contains("cores, energy, energy:chip, latency"), "{said}");
    }
}
