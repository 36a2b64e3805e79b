//! Errors of the compiler's stages.

use crate::reason::Reason;
use nsim_ir::base::diagnostic::Diagnostic;

/// Result of a compiler stage.
pub type Result<T, E = CompileError> = std::result::Result<T, E>;

/// Error of a compiler stage.
#[derive(Debug, thiserror::Error)]
pub enum CompileError {
    /// The network or the mapping cannot be used.
    #[error(transparent)]
    Input(#[from] Diagnostic),
    /// The network does not fit, for all of these reasons.
    #[error("the network does not fit the target: \
             {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; also "))]
    DoesNotFit(Vec<Reason>),
    /// Internal error: a check contradicts the compiler.
    #[error("{0}")]
    Fault(String),
}

impl CompileError {
    /// Returns an internal error with the message of the check that found it.
    pub fn fault(error: impl std::fmt::Display) -> Self {
        CompileError::Fault(error.to_string())
    }
}

impl From<Reason> for CompileError {
    fn from(reason: Reason) -> Self {
        CompileError::DoesNotFit(vec![reason])
    }
}
