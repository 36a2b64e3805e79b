//! `nsim show NAME`: a shipped file as it is.
//!
//! Input: the name of a shipped file, or its kind and name (`chips/tiny`) where several have it.
//! Output: its text, which is RON and can be saved, changed and used in its place.

use crate::cli::context::{Answer, Context, Format};
use nsim_files as io;
use nsim_files::shipped;
use nsim_files::shipped::Shipped;
use nsim_session::error::Error;

/// Print a shipped model, target, chip or preset of constants as RON
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim show nahuku-32                      a target
  nsim show chips/loihi1 > chip.ron        its chip, to be changed
  nsim show davies2018                     a preset of constants
  nsim show                                all names")]
pub struct Args {
    /// A shipped name, with its kind before it where several files have it
    pub name: Option<String>,
}

/// The command.
///
/// # Errors
/// [`Error::Usage`] for a name that no shipped file has, or several have.
pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let Some(name) = &args.name else {
        let names: Vec<&str> = all().map(without_extension).collect();
        let text = match context.format {
            Format::Json => {
                let object = serde_json::json!({ "schema": "nsim.show/1", "names": names });
                format!("{object:#}\n")
            }
            _ => names.iter().map(|name| format!("{name}\n")).collect(),
        };
        io::write::stdout(&text)?;
        return Ok(Answer::Yes);
    };
    let file = find(name)?;
    let text = match context.format {
        Format::Json => {
            let object =
                serde_json::json!({ "schema": "nsim.show/1", "name": without_extension(file), "text": file.text });
            format!("{object:#}\n")
        }
        _ => file.text.to_string(),
    };
    io::write::stdout(&text)?;
    Ok(Answer::Yes)
}

fn all() -> impl Iterator<Item = &'static Shipped> {
    shipped::TABLES.iter().flat_map(|table| table.iter())
}

fn without_extension(file: &'static Shipped) -> &'static str {
    file.path.strip_suffix(".ron").unwrap_or(file.path)
}

fn find(name: &str) -> Result<&'static Shipped, Error> {
    let given = name.strip_suffix(".ron").unwrap_or(name);
    let is = |file: &&'static Shipped| {
        let path = without_extension(file);
        path == given || path.strip_suffix(given).is_some_and(|folder| folder.ends_with('/'))
    };
    let found: Vec<&'static Shipped> = all().filter(is).collect();
    match found.as_slice() {
        [one] => Ok(one),
        [] => Err(Error::Usage(format!("no shipped file is called {name}; nsim show lists them"))),
        several => {
            let names: Vec<&str> = several.iter().map(|file| without_extension(file)).collect();
            Err(Error::Usage(format!("{name} is the name of several files: {}", names.join(", "))))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::cli::inspect::show::*;

    #[test]
    fn shipped_files_are_found_by_name_and_by_kind() {
        assert!(find("nahuku-32").unwrap().text.contains("Target("));
        assert!(find("chips/tiny").unwrap().text.contains("Chip("));
        assert_eq!(find("mapping/chips/tiny.ron").unwrap().text, find("chips/tiny").unwrap().text);
        assert!(find("tiny").unwrap_err().to_string().contains("mapping/targets/tiny"));
        assert_eq!(find("iny").unwrap_err().exit_status(), 2);
        assert!(all().count() > 20);
    }
}
