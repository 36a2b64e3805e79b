//! Settings of every command, and its answer.

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
    /// Rows as a Markdown table, four digits a figure.
    Markdown,
    /// Rows as a LaTeX tabular.
    Latex,
}

/// Settings of every command.
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

/// Answer of a command, with exit status 0 or 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Done, fits, agrees.
    Yes,
    /// Does not fit, does not agree, misses its bound.
    No,
}

/// Returns a usage error with this message if `is_wrong`.
pub fn refuse_if(is_wrong: bool, message: impl Into<String>) -> Result<(), Error> {
    if is_wrong { Err(Error::Usage(message.into())) } else { Ok(()) }
}
