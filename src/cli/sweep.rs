//! `nsim sweep`: many variants of a run in one table.
//!
//! A table file has a journal next to it until it is finished, so an interrupted sweep resumes.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, UNIX_EPOCH};

use serde_json::json;

use crate::cli::args::jobs::MappingArgs;
use crate::cli::args::reading::ReadingArgs;
use crate::cli::context::{Answer, Context, Format};
use crate::cli::output;
use crate::cli::process::progress;
use crate::cli::process::signals;
use nsim_files as io;
use nsim_files::table::{text_of_csv, with_columns};
use nsim_files::write::journal::Journal;
use nsim_report::charts::picture::FILE;
use nsim_report::sweep as picture;
use nsim_session::error::Error;
use nsim_study::sweep::row::{Cells, place};
use nsim_study::sweep::table::{Table, checksum_column, from_line, line};
use nsim_study::sweep::variants::Sweep;
use nsim_study::sweep::{identity, work};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim sweep sweep.ron -o table.csv                                     a row for each variant
  nsim sweep sweep.ron -o table.csv --plot front.svg --axes energy_uj,accuracy
  nsim sweep sweep.ron -o 3.csv --shard 3/8                             the third of eight parts, on any machine
  nsim sweep sweep.ron -o table.csv --merge 1.csv 2.csv 3.csv           the parts together";

/// `--shard`: part `number`, from 1, of `of` parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Shard {
    number: u64,
    of: u64,
}

fn shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
    match parts {
        Some((number, of)) if (1..=of).contains(&number) => Ok(Shard { number, of }),
        _ => Err(format!("'{text}' is not a part such as 3/8, counted from 1")),
    }
}

/// `--axes`
fn columns(text: &str) -> Result<[String; 2], String> {
    match text.split_once(',') {
        Some((x, y)) if !x.is_empty() && !y.is_empty() => Ok([x.to_string(), y.to_string()]),
        _ => Err(format!("'{text}' is not two columns such as energy_uj,accuracy")),
    }
}

/// Run many variants of a network and write a table, a row for each
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Args {
    /// Varied fields and their values
    #[arg(value_name = "SWEEP.ron")]
    sweep: PathBuf,
    #[command(flatten)]
    reading: ReadingArgs,
    #[command(flatten)]
    anew: MappingArgs,
    /// Where to write the table, as CSV; without it the table goes to stdout
    #[arg(short, long, value_name = "FILE.csv")]
    output: Option<PathBuf>,
    /// Run only part I of N, whose table --merge takes
    #[arg(long, value_name = "I/N", value_parser = shard, conflicts_with = "merge")]
    shard: Option<Shard>,
    /// Merge tables of parts, or draw a whole one, instead of running
    #[arg(long, value_name = "FILE.csv", num_args = 1..)]
    merge: Vec<PathBuf>,
    /// Draw the column that --axes names second over the first
    #[arg(long, value_name = FILE, requires = "axes")]
    plot: Option<PathBuf>,
    /// Columns of the printed table [default: of a terminal, those that fit a reader]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',', conflicts_with = "output")]
    columns: Vec<String>,
    /// Two columns; the table of a whole sweep gets a column that says which rows are on their
    /// front
    #[arg(long, value_name = "X,Y", value_parser = columns)]
    axes: Option<[String; 2]>,
}

/// Counts of a summary.
struct VariantCounts {
    run: u64,
    before: u64,
    wall_s: f64,
    /// Variants on the front that equal another one on it.
    ties: usize,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let MappingArgs { relays, prune, taps } = &args.anew;
    let sweep = Sweep::parse(&io::text::read_text(&args.sweep)?)?;
    let sweep = sweep.with(args.reading.reading(), *relays, prune, taps.most());
    let mut table = Table::new(&sweep);
    let axes = args.axes.as_ref().map(|[x, y]| [x.as_str(), y.as_str()]);
    for axis in axes.into_iter().flatten().chain(args.columns.iter().map(String::as_str)) {
        picture::check(&table.columns(), axis)?;
    }
    let file = args.output.as_deref().filter(|path| !io::text::is_standard_stream(path));
    let journal_path = file.map(|path| {
        let mut name = path.as_os_str().to_owned();
        name.push(".journal");
        PathBuf::from(name)
    });
    // A table next to its journal belongs to a sweep that ended before it removed the journal.
    let goes_on = journal_path.as_deref().is_some_and(|path| io::disk::exists(path).unwrap_or(false));
    let all = Context { force: context.force || goes_on, ..context };
    output::check_files(args.output.as_ref().filter(|_| file.is_some()), &args.plot, all)?;
    let begin = Instant::now();
    let (done, journal) = if args.merge.is_empty() {
        run_variants(args, &sweep, &mut table, journal_path.as_deref(), context)?
    } else {
        let identity = checksum_column(&work_digest(args, &sweep));
        for path in &args.merge {
            let text = io::text::read_text(path)?;
            if !table.add_csv(text.text(), Some(&identity)).map_err(|problem| problem.or_in_file(path))? {
                tracing::warn!(
                    "{} is a whole table without checksums, so changed digits and rows of another model, target, input \
                     or --set are not detected",
                    path.display()
                );
            }
        }
        table.check_whole()?;
        (VariantCounts { run: 0, before: table.rows.len() as u64, wall_s: 0.0, ties: 0 }, None)
    };
    let mut batch = io::write::Batch::new(all.force);
    if let (Some(axes), None) = (axes, args.shard) {
        table.front = picture::front(&table, axes)?;
        let aimless = picture::without_direction(&table, axes);
        if !aimless.is_empty() {
            let columns = aimless.join(" and ");
            tracing::warn!(
                "no front: neither less nor more of {columns} is better; of costs and of target. paths less is"
            );
        }
    }
    if let (Some(axes), Some(path)) = (axes, &args.plot) {
        let picture = output::picture_bytes(path, &picture::svg(&table, axes)?)?;
        batch.add(path, |out| out.write_all(&picture))?;
    }
    let checksums = args.shard.map(|_| checksum_column(&work_digest(args, &sweep)));
    if let Some(path) = file {
        table.write(path, checksums.as_deref(), &mut batch)?;
    }
    batch.commit()?;
    if let Some(journal) = journal {
        journal.remove()?;
    }
    let ties = axes.map_or(Ok(0), |axes| picture::ties(&table, axes))?;
    let done = VariantCounts { wall_s: begin.elapsed().as_secs_f64(), ties, ..done };
    print_result(&sweep, &table, checksums.as_deref(), &done, file, &args.columns, context)
}

/// Runs the variants that the journal lacks.
fn run_variants(
    args: &Args,
    sweep: &Sweep,
    table: &mut Table<'_>,
    journal: Option<&Path>,
    context: Context,
) -> Result<(VariantCounts, Option<Journal>), Error> {
    let Shard { number, of } = args.shard.unwrap_or(Shard { number: 1, of: 1 });
    let wanted = |variant: &u64| variant % of == number - 1;
    let mut opened = None;
    if let Some(path) = journal {
        let (journal, lines) = Journal::open(path, &journal_header(args, sweep))?;
        table.rows.extend(lines.iter().filter_map(|line| from_line(line)).filter(|(variant, _)| wanted(variant)));
        opened = Some(journal);
    }
    let before = table.rows.len() as u64;
    let left: Vec<u64> = (0..sweep.len()).filter(wanted).filter(|variant| !table.rows.contains_key(variant)).collect();
    let (run, finished) = (left.len() as u64, Arc::new(AtomicU64::new(before)));
    let (seen, name) = (finished.clone(), journal.map(|path| path.display().to_string()));
    let _ending = signals::at_end(move || {
        let name = name?;
        Some(format!("{} variants are stored in {name}, and the same command continues", seen.load(Ordering::SeqCst)))
    });
    progress::with_bar(context, left.len(), "variants", |progress| {
        work::run(sweep, left, context.threads, |variant, cells| {
            if let Some(journal) = &mut opened {
                journal.add(&line(variant, &cells))?;
            }
            table.rows.insert(variant, cells);
            finished.fetch_add(1, Ordering::SeqCst);
            progress();
            Ok(())
        })
    })?;
    Ok((VariantCounts { run, before, wall_s: 0.0, ties: 0 }, opened))
}

/// Arguments that change variants.
fn variant_arguments(args: &Args) -> impl std::fmt::Debug {
    (args.reading.reading(), &args.anew)
}

/// First line of a journal, by which it is identified: the program's version, and a digest of the
/// part, the sweep, and the size and time of its files, which need not be opened.
fn journal_header(args: &Args, sweep: &Sweep) -> String {
    fn of_file(path: &Path) -> String {
        let facts = std::fs::metadata(path).ok();
        let time = facts.as_ref().and_then(|facts| facts.modified().ok()?.duration_since(UNIX_EPOCH).ok());
        format!("{:?} {time:?}", facts.as_ref().map(std::fs::Metadata::len))
    }
    let digest = digest(&format!("{:?}", (args.shard, variant_arguments(args))), sweep, of_file);
    format!("nsim sweep {} {digest}", env!("CARGO_PKG_VERSION"))
}

/// Identity of the work of all parts, on every machine: a digest of the program's version, the
/// sweep, and the content of its files.
fn work_digest(args: &Args, sweep: &Sweep) -> String {
    let before = format!("{} {:?}", env!("CARGO_PKG_VERSION"), variant_arguments(args));
    digest(&before, sweep, |path| io::text::sha256_of_file(path).unwrap_or_default())
}

/// Digest of `before`, a sweep's text, the `--set` changes, and the files of the sweep. The version
/// determines shipped files.
fn digest(before: &str, sweep: &Sweep, of_file: impl Fn(&Path) -> String) -> String {
    // Without the backslashes of quotes within a value.
    let set = format!("{:?}", io::changes::process_changes()).replace('\\', "");
    let files = identity::files(sweep, &set);
    let files: Vec<(&Path, String)> = files.iter().map(|path| (path.as_path(), of_file(path))).collect();
    io::text::sha256(format!("{:?}", (before, sweep.text(), set, sweep.names(), files)).as_bytes())
}

/// Columns that a terminal does not show.
const UNREAD: [&str; 10] = [
    "fits",
    "samples",
    "timesteps",
    "digest",
    "static_mw",
    "dynamic_mw",
    "edp_pjs",
    "tightest",
    "accuracy_low",
    "accuracy_high",
];

fn print_result(
    sweep: &Sweep,
    table: &Table<'_>,
    checksums: Option<&str>,
    done: &VariantCounts,
    file: Option<&Path>,
    columns: &[String],
    context: Context,
) -> Result<Answer, Error> {
    let errors = table.rows.values().filter(|cells| !cells[place("error")].is_empty()).count();
    let refused = table.rows.values().filter(|cells| cells[place("fits")] == "false").count();
    let is_for_people = context.format == Format::Text && std::io::stdout().is_terminal();
    let csv = || match (columns, context.format) {
        (columns @ [_, ..], _) => with_columns(&table.csv(None), |name| columns.iter().any(|one| one == name)),
        // In a document a row has no room for its digest.
        (_, Format::Markdown | Format::Latex) => with_columns(&table.csv(None), |name| name != "digest"),
        _ if is_for_people => with_columns(&table.csv(None), |name| !UNREAD.contains(&name)),
        _ => table.csv(checksums),
    };
    let Some(file) = file else {
        let text = || if is_for_people { text_of_csv(&csv()) } else { csv() };
        output::print(context.format, text, || json(sweep, table, done, [errors, refused]), csv)?;
        return Ok(Answer::Yes);
    };
    let text = || {
        let VariantCounts { run, before, wall_s, ties } = done;
        let mut text = format!("{}: {}", file.display(), nsim_files::table::count(table.rows.len() as u64, "variant"));
        if *before > 0 {
            text += &format!(", {before} of them from before");
        }
        if errors > 0 {
            text += &format!("; {errors} could not be run, {refused} of them because they do not fit");
        }
        if let Some(front) = &table.front {
            text += &format!("; {} on the front", front.len());
            if *ties > 0 {
                text += &format!(", {ties} of them equal to another in both columns");
            }
        }
        let broken = |cells: &&Cells| !cells[place("error")].is_empty() && cells[place("fits")] != "false";
        if let Some(cells) = table.rows.values().find(broken) {
            text += &format!("\nthe first: {}", cells[place("reason")]);
        }
        text += &format!("\n{run} run in {wall_s:.2} s, {} at a time\n", context.threads);
        text
    };
    output::print(context.format, text, || json(sweep, table, done, [errors, refused]), csv)?;
    Ok(Answer::Yes)
}

fn json(sweep: &Sweep, table: &Table<'_>, done: &VariantCounts, [errors, refused]: [usize; 2]) -> serde_json::Value {
    json!({
        "schema": "nsim.sweep/1", "variants": sweep.len(), "rows": table.rows.len(), "run": done.run,
        "from_before": done.before, "errors": errors, "do_not_fit": refused, "columns": table.columns(),
        "wall_s": done.wall_s,
    })
}
