// Equation (3): x * keep / 4096, rounded toward zero, for |x| <= 2^23 and keep in 0..=4096.
// WGSL has no 64 bits and the product has 36: |x| = high * 4096 + low, so that high * keep <= 2^23 is whole
// already and low * keep < 2^24.
fn decay(x: i32, keep: i32) -> i32 {
    let magnitude = abs(x);
    let high = magnitude >> 12u;
    let low = magnitude & 4095;
    let kept = high * keep + ((low * keep) >> 12u);
    return select(kept, -kept, x < 0);
}
