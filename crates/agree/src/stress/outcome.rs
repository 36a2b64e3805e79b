//! What a case returns.

/// Steps and what was seen, or steps and what is wrong.
pub(super) type Outcome = Result<(u64, String), (u64, String)>;
