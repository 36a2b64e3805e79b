//! Results of a compartment's step besides its state, and the narrowing of integers.

/// Results of an update besides the state.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Outcome {
    pub spiked: bool,
    /// Value of the message, for kinds that compute one.
    pub value: Option<i64>,
    pub q_wrapped: bool,
    pub u_wrapped: bool,
    pub v_clipped: bool,
}

/// Two's complement wrap to `bits` bits and a sign.
pub(crate) fn wrap(x: i64, bits: u32) -> i64 {
    let half = 1i64 << bits;
    (x + half).rem_euclid(2 * half) - half
}

/// Equation (3). Division rounds toward zero.
pub(crate) fn decay(x: i64, d: impl Into<i64>) -> i64 {
    let d: i64 = d.into();
    x * (4096 - d) / 4096
}

/// Returns the value wrapped to 32 bits; sets `wrapped` if this changes it.
pub(crate) fn word(x: i64, wrapped: &mut bool) -> i64 {
    let kept = wrap(x, 31);
    *wrapped |= kept != x;
    kept
}

/// The outcome of a neuron that sends an integer, unless it is 0.
pub(crate) fn sent(message: i64, u_wrapped: bool) -> Outcome {
    Outcome { spiked: message != 0, value: Some(message), u_wrapped, ..Outcome::default() }
}
