//! Functions that several commands share: printing, sections of documents.

use std::path::{Path, PathBuf};

use crate::cli::context::{Context, Format, refuse_if};
use crate::cli::process::progress;
use nsim_energy::environment::Environment;
use nsim_files as io;
use nsim_files::table::{latex, markdown, replace_section};
use nsim_files::warnings::shown;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_report::charts::picture::{ENDINGS, PictureFormat};
use nsim_session::error::Error;

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
    Ok(progress::print(&out)?)
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
