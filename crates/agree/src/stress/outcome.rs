//! Outcome of a case.

/// Number of steps, with the observed counts or with the error.
pub(super) type Outcome = Result<(u64, String), (u64, String)>;
