//! `nsim report`: a run, or saved results, as one page.
//!
//! Output: an HTML file that opens without a network. A model is run and priced as in `nsim
//! energy`; the page has every step of its first sample. A model in real numbers is also compared
//! with its trained form.

use std::path::{Path, PathBuf};

use crate::cli::args::saved;
use crate::cli::context::{Answer, Context, Format, refuse_if};
use crate::cli::energy::args::CostArgs;
use crate::cli::energy::evaluate::evaluate;
use crate::cli::process::progress;
use nsim_energy::evaluate::Evaluation;
use nsim_energy::workload::Workload;
use nsim_files as io;
use nsim_ir::stimulus::{InputArg, InputSource};
use nsim_report::page::job::{agreement, compared, sections, trained};
use nsim_report::page::{Origin, Provenance, Sections, html};
use nsim_session::error::Error;

const EXAMPLES: &str = "\
EXAMPLES:
  nsim report -o report.html                      the shipped network: fit, spikes, power, time, energy
  nsim report model.ron --input spikes.npy -o report.html
  nsim report vtsnn-slip-srm -o report.html       a trained network, and how its deployed form agrees with it
  nsim report a.json b.json -o compared.html      two results of nsim energy or nsim run --format json, side by side";

/// Write a page that shows a run: fit onto cores, spikes, potentials, power, time, energy, and
/// comparisons
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    #[command(flatten)]
    cost: CostArgs,
    /// A second result to compare with, where MODEL is one: an object that nsim energy or nsim run
    /// printed
    #[arg(value_name = "RESULT.json")]
    other: Option<PathBuf>,
    /// Where to write the page
    #[arg(short, long, value_name = "FILE.html")]
    output: PathBuf,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let is_data = context.format != Format::Text;
    refuse_if(is_data, "nsim report writes a page; for data use nsim energy --format json")?;
    let is_page =
        |path: &Path| path.extension().is_some_and(|end| ["html", "htm"].iter().any(|e| end.eq_ignore_ascii_case(e)));
    let is_other = !is_page(&args.output) && !io::text::is_standard_stream(&args.output);
    refuse_if(is_other, format!("{}: a page is HTML; name it .html", args.output.display()))?;
    io::write::check_all_free([&args.output], context.force)?;
    if saved::is_result(&args.cost.job.model) {
        return saved_results(args, context);
    }
    if let Some(other) = &args.other {
        let message = "to compare two files, the first must also be a result";
        return Err(Error::Usage(format!("{}: {message}", other.display())));
    }
    evaluate(&args.cost, None, context, |workload, evaluated| page(args, workload, &evaluated, context))
}

/// Writes a page of one or two saved results.
fn saved_results(args: &Args, context: Context) -> Result<Answer, Error> {
    let (mut results, mut origins) = (Vec::new(), Vec::new());
    for path in [Some(Path::new(&args.cost.job.model)), args.other.as_deref()].into_iter().flatten() {
        let help = "give JSON that nsim energy or nsim run printed with --format json";
        let (result, text) = saved::read(path, &["nsim.energy/1", "nsim.run/1"], help)?;
        origins.push(origin("result", &path.display().to_string(), text.text().as_bytes()));
        results.push(result);
    }
    // Two results are often of one model.
    let title = match results.as_slice() {
        [one] => one["model"].as_str().unwrap_or("a run").to_string(),
        _ => origins.iter().map(|origin| origin.name.as_str()).collect::<Vec<_>>().join(" beside "),
    };
    let sections = Sections { results, ..Sections::default() };
    write(args, &title, &sections, origins, context)
}

/// Writes the page of a run.
fn page(args: &Args, workload: &Workload<'_>, evaluated: &Evaluation, context: Context) -> Result<Answer, Error> {
    let (target, network) = (workload.target, &workload.compiled.one);
    // A model from a pipe cannot be read again: it is neither compared nor hashed.
    let piped = io::text::is_standard_stream(Path::new(&args.cost.job.model));
    let file = (!piped).then(|| args.cost.job.reading.load(&args.cost.job.model)).transpose()?;
    let mut sections = sections(workload, evaluated, args.cost.transport)?;
    if let Some(trained) = file.as_ref().map(|file| trained(workload, file)).transpose()?.flatten() {
        let compared = compared(workload);
        sections.agreement =
            progress::with_bar(context, compared, "samples compared", |done| agreement(workload, &trained, done))?;
    }
    let source = file.iter().map(|file| origin("model", &args.cost.job.model, file.source().text().as_bytes()));
    let mut origins: Vec<Origin> = source.collect();
    for argument in &args.cost.input.input {
        if let Ok(InputArg { source: InputSource::Path(path), .. }) = InputArg::parse(argument)
            && path.is_file()
        {
            origins.push(origin_of_file("input", &path)?);
        }
    }
    let job = &args.cost.job;
    for (what, path) in [("target", job.target.as_deref().map(Path::new)), ("mapping", job.mapping.as_deref())] {
        if let Some(path) = path.filter(|path| path.is_file()) {
            origins.push(origin_of_file(what, path)?);
        }
    }
    let title = format!("{} on {}", network.parts().name, target.name());
    write(args, &title, &sections, origins, context)
}

fn origin(what: &'static str, name: &str, bytes: &[u8]) -> Origin {
    Origin { what, name: name.to_string(), sha256: io::text::sha256(bytes) }
}

fn origin_of_file(what: &'static str, path: &Path) -> Result<Origin, Error> {
    Ok(Origin { what, name: path.display().to_string(), sha256: io::text::sha256_of_file(path)? })
}

fn write(
    args: &Args,
    title: &str,
    sections: &Sections,
    origins: Vec<Origin>,
    context: Context,
) -> Result<Answer, Error> {
    fn quoted(word: String) -> String {
        match word.chars().all(|c| c.is_alphanumeric() || "-_./:=,+".contains(c)) {
            true => word,
            false => format!("'{}'", word.replace('\'', "'\\''")),
        }
    }
    // `--force` does not affect the content of the page.
    let words = std::env::args_os().skip(1).filter(|word| word != "--force");
    let words = words.map(|word| quoted(word.to_string_lossy().into_owned()));
    let command = std::iter::once("nsim".to_string()).chain(words).collect::<Vec<_>>().join(" ");
    let page = html(title, sections, &Provenance { command, origins });
    io::write::text(&args.output, context.force, &page)?;
    if !io::text::is_standard_stream(&args.output) {
        let size = page.len() as f64 / f64::from(1 << 20);
        progress::print(&format!("{}: {title}, {size:.1} MiB\n", args.output.display()))?;
    }
    Ok(Answer::Yes)
}
