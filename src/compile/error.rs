//! Why there is no mapping.

use crate::base::diagnostic::Diagnostic;
use crate::compile::reason::Reason;
use crate::error::Error;

/// What a stage of the compiler returns.
pub type Result<T, E = CompileError> = std::result::Result<T, E>;

/// Why there is no mapping.
#[derive(Debug, thiserror::Error)]
pub enum CompileError {
    /// The network or the mapping cannot be used.
    #[error(transparent)]
    Input(#[from] Diagnostic),
    /// The network does not fit, for all of these reasons.
    #[error("the network does not fit the target: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; also "))]
    DoesNotFit(Vec<Reason>),
    /// The compiler has contradicted itself.
    #[error("{0}")]
    Fault(String),
}

impl CompileError {
    /// A contradiction that a check found.
    pub fn fault(error: impl std::fmt::Display) -> Self {
        CompileError::Fault(error.to_string())
    }
}

impl From<Reason> for CompileError {
    fn from(reason: Reason) -> Self {
        CompileError::DoesNotFit(vec![reason])
    }
}

impl From<CompileError> for Error {
    /// A network that does not fit is an answer; a command that has no such answer reports an unusable input.
    fn from(error: CompileError) -> Self {
        match error {
            CompileError::Input(diagnostic) => diagnostic.into(),
            CompileError::Fault(message) => Error::Fault(message),
            CompileError::DoesNotFit(_) => Diagnostic::new("map.does-not-fit", error.to_string()).into(),
        }
    }
}
