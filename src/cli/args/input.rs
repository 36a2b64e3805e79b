//! `--input` and related options: the samples of a run.

use std::ops::Range;

use crate::cli::args::values::sample_range;
use crate::cli::context::refuse_if;
use crate::cli::process::progress;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_quantise::prune::check_stimulus;
use nsim_session::error::Error;
use nsim_session::inputs::{self, MOST_REPEATS, repeated_indices};

/// Sources and selection of the input samples of a run.
#[derive(Debug, Clone, clap::Args)]
pub struct InputArgs {
    /// Input spikes: SOURCE, or POPULATION=SOURCE when the model has several input populations
    /// [default: the model's scene]
    #[arg(long, value_name = "SOURCE")]
    pub input: Vec<String>,
    /// Classes of the samples of the first --input: a .npy file with a number for each
    #[arg(long, value_name = "FILE.npy", requires = "input")]
    pub labels: Option<String>,
    /// Only these samples, such as 0..20
    #[arg(long, value_name = "A..B", value_parser = sample_range)]
    pub samples: Option<Range<usize>>,
    /// Run all samples N times; each starts from rest, learning anew each time
    #[arg(
        long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_REPEATS))
    )]
    pub repeat: u32,
    /// Seed of a synthetic scene, and of the random numbers of learning
    #[arg(long)]
    pub seed: Option<u64>,
}

impl InputArgs {
    /// The sources, the first with the file of its labels.
    ///
    /// # Errors
    /// [`Error::Usage`] for labels with a scene, or in a file whose name contains `?` or `&`.
    pub fn sources(&self) -> Result<Vec<String>, Error> {
        let mut sources = self.input.clone();
        if let (Some(labels), Some(first)) = (&self.labels, sources.first_mut()) {
            let is_wrong = labels.contains(['?', '&']) || first.contains("scene:");
            refuse_if(is_wrong, format!("--labels {labels}: labels are a file beside recordings, without ? and &"))?;
            let begun = first.rsplit_once('?').is_some_and(|(_, query)| query.contains('='));
            *first = format!("{first}{}labels={labels}", if begun { '&' } else { '?' });
        }
        Ok(sources)
    }

    /// Reads or makes the samples; `scene` is the model's own.
    ///
    /// # Errors
    /// Those of [`inputs::stimulus`].
    pub fn stimulus(&self, network: &Quantised, scene: Option<&str>) -> Result<Stimulus, Error> {
        let _busy = progress::stage("reading or making samples");
        inputs::stimulus(network, &self.sources()?, scene, self.seed)
    }

    /// Command-line options with the sources and seed of these samples.
    pub fn words(&self) -> Vec<String> {
        let sources = self.sources().unwrap_or_default().into_iter().map(|source| ("--input", source));
        let options = sources.chain(self.seed.map(|seed| ("--seed", seed.to_string())));
        options.flat_map(|(name, value)| [name.to_string(), value]).collect()
    }
}

/// Selected samples, repeated `--repeat` times.
pub fn select<'a>(samples: &'a [Sample], args: &InputArgs) -> Result<Vec<&'a Sample>, Error> {
    Ok(select_numbers(samples.len(), args)?.into_iter().map(|number| &samples[number]).collect())
}

/// Numbers of the selected samples out of `samples`, repeated `--repeat` times.
///
/// # Errors
/// [`Error::Usage`] for a range that is empty or ends after the last sample; `input.too-many`.
pub fn select_numbers(samples: usize, args: &InputArgs) -> Result<Vec<usize>, Error> {
    let range = args.samples.clone().unwrap_or(0..usize::MAX);
    let (start, end, last) = (range.start, range.end, samples.max(1) - 1);
    let is_beyond = end != usize::MAX && end > samples;
    refuse_if(is_beyond, format!("--samples {start}..{end}: there are {samples} samples, 0 to {last}"))?;
    let chosen = start..end.min(samples);
    refuse_if(chosen.is_empty(), format!("--samples {start}..: there are {samples} samples"))?;
    Ok(repeated_indices(chosen, args.repeat)?)
}

/// Refuses samples that use pruned channels; samples are numbered as in the input.
///
/// # Errors
/// `input.pruned`.
pub fn check_pruned(network: &Quantised, samples: &[&Sample], args: &InputArgs) -> Result<(), Error> {
    let first = args.samples.as_ref().map_or(0, |range| range.start);
    let once = samples.len() / args.repeat as usize;
    Ok(check_stimulus(network, &samples[..once], first)?)
}
