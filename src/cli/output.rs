//! Functions that several commands share: printing, progress, sections of documents.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::cli::context::{Context, Format, refuse_if};
use nsim_energy::environment::Environment;
use nsim_files as io;
use nsim_files::table::{latex, markdown, replace_section};
use nsim_files::warnings::shown;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_report::charts::picture::{ENDINGS, PictureFormat};
use nsim_session::error::Error;
use nsim_session::samples::Progress;

/// The words after `nsim` on the command line, without the number of threads, on which no result
/// depends.
pub fn command_words() -> Vec<String> {
    let mut words = std::env::args().skip(1);
    let mut typed = Vec::new();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--threads" => _ = words.next(),
            _ if word.starts_with("--threads=") => {}
            _ => typed.push(word),
        }
    }
    typed
}

/// Checks the files of a command before its work: each may be written, pictures have the name of a
/// known format, and stdout carries one output. Returns whether that is a file, which replaces the
/// result.
///
/// # Errors
/// [`Error::Usage`] for a picture of another format, `-` with a format other than text, and two
/// files on stdout; `write.*`.
pub fn check_files<'a>(
    files: impl IntoIterator<Item = &'a PathBuf>,
    pictures: impl IntoIterator<Item = &'a PathBuf>,
    context: Context,
) -> Result<bool, Error> {
    let pictures: Vec<&PathBuf> = pictures.into_iter().collect();
    for picture in &pictures {
        picture_format(picture)?;
    }
    let all: Vec<&PathBuf> = files.into_iter().chain(pictures).collect();
    let on_stdout = all.iter().filter(|path| io::text::is_standard_stream(path)).count();
    refuse_if(on_stdout > 1, "only one file can be written to stdout")?;
    let both = on_stdout == 1 && context.format != Format::Text;
    refuse_if(both, "stdout is used for the result: give the file a name other than -")?;
    io::write::check_all_free(all, context.force)?;
    Ok(on_stdout == 1)
}

/// Format of a picture, by its name; SVG on stdout.
fn picture_format(path: &Path) -> Result<PictureFormat, Error> {
    if io::text::is_standard_stream(path) {
        return Ok(PictureFormat::Svg);
    }
    let known = PictureFormat::from_name(path).ok_or_else(|| format!("name the picture {ENDINGS}"));
    known
        .and_then(|format| format.check(path).map(|()| format))
        .map_err(|message| Error::Usage(format!("{}: {message}", path.display())))
}

/// The bytes of a picture for a file of this name.
///
/// # Errors
/// [`Error::Usage`] for a name of another format; a fault when it cannot be drawn.
pub fn picture_bytes(path: &Path, svg: &str) -> Result<Vec<u8>, Error> {
    let drawn = picture_format(path)?.bytes(svg);
    drawn.map_err(|message| Error::Fault(format!("{}: {message}", path.display())))
}

/// Writes a picture in the format of its name.
pub fn write_picture(path: &Path, svg: &str, context: Context) -> Result<(), Error> {
    let bytes = picture_bytes(path, svg)?;
    Ok(io::write::file(path, context.force, |out| out.write_all(&bytes))?)
}

/// Prints a result in the requested format.
///
/// # Errors
/// When stdout cannot be written; a closed pipe is no error.
pub fn print(
    format: Format,
    plain: impl FnOnce() -> String,
    json: impl FnOnce() -> serde_json::Value,
    csv: impl FnOnce() -> String,
) -> Result<(), Error> {
    let out = match format {
        Format::Text => plain(),
        Format::Json => {
            let mut result = json();
            if let serde_json::Value::Object(fields) = &mut result {
                fields.insert("warnings".to_string(), serde_json::json!(shown()));
            }
            format!("{:#}\n", checksum::printed(result))
        }
        Format::Csv => csv(),
        Format::Markdown => markdown(&csv()),
        Format::Latex => latex(&csv()),
    };
    Ok(io::write::stdout(&out)?)
}

/// Whether stages without countable parts are displayed.
static SPINNERS_ALLOWED: AtomicBool = AtomicBool::new(false);
/// Number of active bars and stages. A stage is displayed only if no other is active.
static ACTIVE_STAGES: AtomicUsize = AtomicUsize::new(0);

/// Sets whether [`spinner`] shows stages.
pub fn allow_spinners(shown: bool) {
    SPINNERS_ALLOWED.store(shown, Ordering::Relaxed);
}

/// A stage without countable parts. From the second second on, a line on stderr names it, until
/// this is dropped.
#[derive(Debug)]
pub struct Spinner(ProgressBar);

/// Begins a stage, which is hidden if a bar or another stage is active.
pub fn spinner(what: &'static str) -> Spinner {
    let alone = ACTIVE_STAGES.fetch_add(1, Ordering::Relaxed) == 0;
    if !alone || !SPINNERS_ALLOWED.load(Ordering::Relaxed) {
        return Spinner(ProgressBar::hidden());
    }
    let line = hidden_at_first(None, "{spinner} {msg}, {elapsed}", what);
    let shown = line.clone();
    // Without a thread the line does not move.
    let _ = std::thread::Builder::new().spawn(move || {
        while !shown.is_finished() {
            shown.tick();
            std::thread::sleep(std::time::Duration::from_millis(200));
        }
    });
    Spinner(line)
}

/// A bar or line on stderr that appears after a second unless it is finished before.
fn hidden_at_first(length: Option<u64>, template: &str, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::hidden()).with_style(style).with_message(what);
    let shown = bar.clone();
    // Without a thread there is no bar.
    let _ = std::thread::Builder::new().spawn(move || {
        std::thread::sleep(std::time::Duration::from_secs(1));
        if !shown.is_finished() {
            shown.set_draw_target(ProgressDrawTarget::stderr());
        }
    });
    bar
}

impl Drop for Spinner {
    fn drop(&mut self) {
        ACTIVE_STAGES.fetch_sub(1, Ordering::Relaxed);
        self.0.finish_and_clear();
    }
}

/// Runs `work` under a progress bar; it calls its argument after each of `length` parts.
pub fn with_progress<T>(
    context: Context,
    length: usize,
    what: &'static str,
    work: impl FnOnce(Progress<'_>) -> T,
) -> T {
    let bar = progress(context, length as u64, what);
    ACTIVE_STAGES.fetch_add(1, Ordering::Relaxed);
    let result = work(&|| bar.inc(1));
    ACTIVE_STAGES.fetch_sub(1, Ordering::Relaxed);
    bar.finish_and_clear();
    result
}

/// A progress bar on stderr that appears after a second, or none.
pub fn progress(context: Context, length: u64, what: &'static str) -> ProgressBar {
    if !context.progress {
        return ProgressBar::hidden();
    }
    hidden_at_first(Some(length), "{msg} [{bar:40}] {pos}/{len} {eta}", what)
}

/// Environment of a measurement; warns of a build without optimisation.
pub fn environment() -> Environment {
    let environment = Environment::here();
    if environment.profile == "debug" {
        tracing::warn!("this nsim was built without --release; its times are not meaningful");
    }
    environment
}

/// Replaces the section `<!-- MARK -->` of a document, and writes the picture, by name, next to it.
pub fn update_section(
    path: &Path,
    mark: &str,
    section: &str,
    picture: Option<(&str, &str)>,
    context: Context,
) -> Result<(), Error> {
    let text = io::text::read_text(path)?;
    let changed = replace_section(text.text(), mark, section).ok_or_else(|| {
        Diagnostic::new("document.section", format!("there is no section '<!-- {mark} -->'"))
            .help(format!("put '<!-- {mark} -->' and '<!-- end {mark} -->' on lines of their own"))
            .in_file(path)
    })?;
    if let Some((name, svg)) = picture {
        write_picture(&path.parent().unwrap_or(Path::new("")).join(name), svg, context)?;
    }
    Ok(io::write::file(path, context.force, |out| out.write_all(changed.as_bytes()))?)
}
