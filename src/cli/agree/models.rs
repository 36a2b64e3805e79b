//! `nsim agree MODEL --against FILE..`: a trained network compared with other model files in
//! integers.
//!
//! Input: the network, one or several model files, samples. Output: for one file the comparison
//! layer by layer, for several files one table. Errors: files of other populations; pictures of
//! more than one comparison.

use std::path::Path;

use crate::cli::agree::args::{Args, answer, deployed_warnings, draw, within_bounds};
use crate::cli::args::jobs::Refusal;
use crate::cli::context::{Answer, Context, refuse_if};
use crate::cli::output;
use crate::cli::process::progress;
use nsim_agree::compare::compare_models;
use nsim_compile::{CompileError, Mapping, refuse_large};
use nsim_files as io;
use nsim_files::warnings::show;
use nsim_import::kind::FileKind;
use nsim_ir::graph::Graph;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_report::agree::{AgreeReport, role};
use nsim_report::side_by_side::{ComparedNetwork, SideBySideReport};
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_session::obtain::map_with_defaults;
use nsim_train::convert::staged::is_real;

/// A trained network and its integers, the samples on which it is compared, and the target.
pub(super) struct Compared<'c> {
    pub graph: &'c Graph,
    pub integers: &'c Quantised,
    pub stimulus: &'c Stimulus,
    pub samples: &'c [&'c Sample],
    pub target: &'c Target,
    pub context: Context,
}

impl Compared<'_> {
    pub fn name(&self) -> &str {
        &self.graph.facts().name
    }

    pub fn input(&self) -> (&[String], Option<u64>, usize) {
        (&self.stimulus.origin, self.stimulus.seed, self.samples.len())
    }

    /// A network on simulated cores; none where it does not fit, after printing the reasons.
    pub fn deployed(&self, model: &str, network: &Quantised) -> Result<Option<Mapping>, Error> {
        match map_with_defaults(network.clone(), self.target) {
            Ok(compiled) => Ok(Some(compiled)),
            Err(CompileError::DoesNotFit(reasons)) => {
                let refusal = Refusal::new(model, self.target.clone(), reasons);
                refusal.print(nsim_report::agree::empty_result(), self.context)?;
                Ok(None)
            }
            Err(other) => Err(other.into()),
        }
    }
}

/// Model files that `--against` names; none where it names other things.
///
/// # Errors
/// Usage, where some names are model files and others are not.
pub(super) fn model_files(against: &[String]) -> Result<Vec<&str>, Error> {
    let is_model = |word: &&str| {
        let path = Path::new(word);
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        let foreign = extension.as_deref().is_some_and(|extension| ["nir", "net"].contains(&extension))
            || FileKind::detect(path).is_ok_and(|kind| kind == FileKind::Torch);
        // A manifest of recorded spikes is RON as well.
        let written = extension.as_deref() == Some("ron");
        let model = written && io::text::read_text(path).is_ok_and(|text| text.text().contains("Network("));
        path.exists() && (foreign || model)
    };
    let models: Vec<&str> = against.iter().map(String::as_str).filter(is_model).collect();
    let is_mixed = !models.is_empty() && models.len() < against.len();
    refuse_if(is_mixed, "several --against must be all model files or all recorded spikes")?;
    Ok(models)
}

/// Compares the trained network with each file in integers. Returns each comparison with the role
/// of the file; none where a network does not fit.
fn compare_each(
    args: &Args,
    trained: &Compared<'_>,
    files: &[&str],
) -> Result<Option<Vec<(ComparedNetwork, &'static str)>>, Error> {
    let Compared { graph, integers, samples, context, .. } = *trained;
    // A network in real numbers is not mapped: it runs in its trained form.
    let mapped = if is_real(graph) { None } else { trained.deployed(&args.model, integers)? };
    if mapped.is_none() && !is_real(graph) {
        return Ok(None);
    }
    let mut all = Vec::new();
    for file in files {
        let (other, second) = real_and_integers(&args.reading.load_other(file)?)?;
        refuse_large("nsim agree", &second, 1)?;
        let Some(compiled) = trained.deployed(file, &second)? else { return Ok(None) };
        let first = (graph, integers, mapped.as_ref().map(|mapped| &mapped.program));
        let agreement = progress::with_bar(context, samples.len(), "samples", |done| {
            compare_models(first, (&second, &compiled.program), samples, args.steps, done)
        })?;
        show("", &deployed_warnings(&compiled, samples)?);
        let (against, name) = ((*file).to_string(), second.parts().name.clone());
        all.push((ComparedNetwork { against, name, cores: compiled.program.cores().len(), agreement }, role(&other)));
    }
    Ok(Some(all))
}

/// Compares a trained network with another model file.
pub(super) fn with_one(args: &Args, trained: &Compared<'_>, other: &str) -> Result<Answer, Error> {
    let all = compare_each(args, trained, &[other])?;
    let Some((ComparedNetwork { name, agreement, .. }, second)) = all.and_then(|mut all| all.pop()) else {
        return Ok(Answer::No);
    };
    let files = draw(args, trained.name(), &agreement.layers, trained.context)?;
    let names = [(trained.name(), role(trained.graph)), (&name, second)];
    let two = AgreeReport::for_two_networks(names, trained.input(), &agreement);
    let report = AgreeReport { files: &files, target: Some(trained.target.name()), ..two };
    answer(args, &report, args.plot.as_deref().is_some_and(io::text::is_standard_stream), trained.context)
}

/// Compares a trained network with several model files.
pub(super) fn with_several(args: &Args, trained: &Compared<'_>, files: &[&str]) -> Result<Answer, Error> {
    let shows_one = args.plot.is_some() || args.plot_causes.is_some() || args.update.is_some();
    refuse_if(shows_one, "--plot, --plot-causes and --update show one comparison: give one --against")?;
    let Some(all) = compare_each(args, trained, files)? else { return Ok(Answer::No) };
    let report = SideBySideReport {
        model: trained.name(),
        input: &trained.stimulus.origin,
        seed: trained.stimulus.seed,
        samples: trained.samples.len(),
        networks: all.into_iter().map(|(compared, _)| compared).collect(),
    };
    output::print(trained.context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(within_bounds(args, report.class_agreement(), report.exact()))
}
