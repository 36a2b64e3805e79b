//! Why there is no mapping.

use crate::reason::Reason;
use nsim_ir::base::diagnostic::Diagnostic;

/// What a stage of the compiler returns.
pub type Result<T, E = CompileError> = std::result::Result<T, E>;

/// Why there is no mapping.
#[derive(Debug, thiserror::Error)]
pub enum CompileError {
    /// The network or the mapping cannot be used.
    #[error(transparent)]
    Input(#[from] Diagnostic),
    /// The network does not fit, for all of these reasons.
    #[error("the network does not fit the target: \
             {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; also "))]
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
