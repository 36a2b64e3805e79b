//! What every command knows, and what it answers.

use nsim_session::error::Error;

/// How results are printed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// For people.
    #[default]
    Text,
    /// One object with a `schema` key.
    Json,
    /// Rows with a header.
    Csv,
    /// The same rows as a Markdown table, four digits a figure.
    Markdown,
    /// The same as a LaTeX tabular.
    Latex,
}

/// What every subcommand knows.
#[derive(Debug, Clone, Copy)]
pub struct Context {
    /// How to print the result on stdout.
    pub format: Format,
    /// Whether existing files may be replaced.
    pub force: bool,
    /// Whether stderr is a terminal that shows progress bars.
    pub progress: bool,
    /// Threads in use.
    pub threads: usize,
}

/// What a command found out: the exit status is 0 or 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Done, fits, agrees.
    Yes,
    /// Does not fit, does not agree, misses its bound.
    No,
}

/// Refuses what was typed where something is wrong with it.
pub fn refuse_if(is_wrong: bool, message: impl Into<String>) -> Result<(), Error> {
    if is_wrong { Err(Error::Usage(message.into())) } else { Ok(()) }
}
