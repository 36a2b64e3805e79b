//! The vectors of the processor that steps use.
//!
//! Input: the processor, and the variable `NSIM_VECTORS`, read once: `avx2` for vectors of half the
//! width of AVX-512, `scalar` for the vectors that the program was built for. Output: the widest
//! that the processor has and the variable allows. Results do not depend on it; it serves to
//! measure narrower processors. Errors: another value.

use std::sync::LazyLock;

const VARIABLE: &str = "NSIM_VECTORS";

static DETECTED: LazyLock<Result<pulp::Arch, String>> = LazyLock::new(|| match std::env::var_os(VARIABLE) {
    None => Ok(pulp::Arch::new()),
    Some(requested) => match requested.to_str() {
        Some("") => Ok(pulp::Arch::new()),
        Some("scalar") => Ok(pulp::Arch::Scalar),
        Some("avx2") => Ok(halved()),
        _ => Err(format!("{VARIABLE}={}: it is avx2, scalar, or not set", requested.to_string_lossy())),
    },
});

/// AVX2 where the processor has it, else the vectors of the build.
pub(super) fn halved() -> pulp::Arch {
    #[cfg(target_arch = "x86_64")]
    if let Some(vectors) = pulp::x86::V3::try_new() {
        return pulp::Arch::V3(vectors);
    }
    pulp::Arch::Scalar
}

/// The vectors that steps use; the widest where the variable is invalid.
pub fn vectors() -> pulp::Arch {
    DETECTED.as_ref().map_or_else(|_| pulp::Arch::new(), |found| *found)
}

/// Refuses an invalid variable.
///
/// # Errors
/// A message with the value and the valid ones.
pub fn check() -> Result<(), String> {
    DETECTED.as_ref().map(|_| ()).map_err(Clone::clone)
}

/// Name of the vectors in use.
pub fn name() -> &'static str {
    match vectors() {
        pulp::Arch::Scalar => "scalar",
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V3(_) => "avx2",
        #[cfg(target_arch = "x86_64")]
        pulp::Arch::V4(_) => "avx512",
        _ => "other",
    }
}
