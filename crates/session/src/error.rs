//! Everything that can end a command early, and its exit status.

use nsim_compile::CompileError;
use nsim_ir::base::diagnostic::Diagnostic;

/// What a command's work returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why a command could not do its work. "Does not fit" and "does not agree" are answers, not
/// errors.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An input cannot be read or is not supported: exit status 3.
    #[error("{0}")]
    Input(Box<Diagnostic>),
    /// What is asked for makes no sense: exit status 2.
    #[error("{0}")]
    Usage(String),
    /// An internal error: exit status 4.
    #[error("this is a fault of nsim: {0}")]
    Fault(String),
}

impl Error {
    /// The process's exit status.
    #[must_use]
    pub fn exit_status(&self) -> u8 {
        match self {
            Error::Usage(_) => 2,
            // What was asked for is never done, whatever the input.
            Error::Input(diagnostic) if diagnostic.code == "write.not-regular" => 2,
            Error::Input(_) => 3,
            Error::Fault(_) => 4,
        }
    }
}

impl From<Diagnostic> for Error {
    fn from(diagnostic: Diagnostic) -> Self {
        Error::Input(Box::new(diagnostic))
    }
}

impl From<CompileError> for Error {
    /// A network that does not fit is an answer; a command that has no such answer reports an
    /// unusable input.
    fn from(error: CompileError) -> Self {
        match error {
            CompileError::Input(diagnostic) => diagnostic.into(),
            CompileError::Fault(message) => Error::Fault(message),
            CompileError::DoesNotFit(_) => Diagnostic::new("map.does-not-fit", error.to_string()).into(),
        }
    }
}
