//! What every command knows, and what it answers.

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
