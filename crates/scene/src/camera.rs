//! An event camera: brightness of pixels -> events on changes of its logarithm, pooled 4 x 4.
//!
//! Input: a view that returns a pixel's brightness (natural logarithm), and the pixels that may
//! have changed. Output: the pooled channels that spike in a tick. A pixel sends an event when its
//! brightness differs from the brightness at its last event by the contrast threshold.
//! (Lichtsteiner, Posch and Delbruck, "A 128x128 120 dB 15 us latency asynchronous temporal
//! contrast vision sensor", IEEE JSSC 2008.) Then it is silent for its refractory time; noise
//! events are added. A pooled unit spikes in a tick in which one of its 16 pixels has an event.
//! Polarities are merged, or each has a plane, as in the recordings of Taunyazov et al. 2020. A
//! noise event has a random polarity.
//! Window, pooling and the order of the channels are VT-SNN's: 200 columns x 250 rows, 4 x 4 to 50
//! columns x 63 rows (the last row of units sees two rows of pixels), channel = row of units x 50 +
//! column.

use pulp::{Arch, Simd, WithSimd};

use super::draw::{Draws, Purpose};

/// Columns of pixels.
pub const WIDTH: usize = 200;
/// Rows of pixels.
pub const HEIGHT: usize = 250;
/// Pixels of a pooled unit along each axis.
pub const POOL: usize = 4;
/// Columns of pooled units.
pub const POOLED_WIDTH: usize = WIDTH.div_ceil(POOL);
/// Rows of pooled units.
pub const POOLED_HEIGHT: usize = HEIGHT.div_ceil(POOL);
/// Pooled units: the channels of the vision population, or of each of its polarity planes.
pub const POOLED: usize = POOLED_WIDTH * POOLED_HEIGHT;

/// The pooled unit of a pixel.
#[inline]
pub fn pooled(x: usize, y: usize) -> usize {
    y / POOL * POOLED_WIDTH + x / POOL
}

/// Polarities of a pooled unit's spikes in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Polarities {
    /// Some pixel became darker.
    pub falls: bool,
    /// Some pixel became brighter.
    pub rises: bool,
}

impl Polarities {
    /// The numbers of the planes: 0 for falls, 1 for rises.
    pub fn planes(self) -> impl Iterator<Item = u32> {
        [self.falls, self.rises].into_iter().zip(0..).filter(|(spikes, _)| *spikes).map(|(_, plane)| plane)
    }
}

/// Parameters of the pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Pixels {
    /// Change of the natural logarithm of brightness that makes an event.
    pub contrast: f64,
    /// Relative standard deviation of the threshold from pixel to pixel.
    pub mismatch: f64,
    /// Shortest time between two events of a pixel, ms.
    pub refractory_ms: u16,
    /// Noise events of a pixel, in each second.
    pub noise_hz: f64,
    /// Sampling interval of the brightness, ms.
    pub tick_ms: u16,
}

impl Default for Pixels {
    fn default() -> Self {
        Pixels { contrast: 0.2, mismatch: 0.1, refractory_ms: 2, noise_hz: 0.3, tick_ms: 1 }
    }
}

#[derive(Debug, Clone, Copy)]
struct Pixel {
    /// Brightness at the last event.
    reference: f32,
    threshold: f32,
    /// The first step in which it may send again.
    free_at: u16,
    seen: bool,
}

/// What a camera sees.
pub trait View: Copy {
    /// Brightness of a pixel, as a natural logarithm. Implementations are inlined into loops over
    /// pixels.
    fn at(&self, x: u32, y: u32) -> f32;
}

impl<F: Fn(u32, u32) -> f32 + Copy> View for F {
    #[inline(always)]
    fn at(&self, x: u32, y: u32) -> f32 {
        self(x, y)
    }
}

/// Brightness of some pixels: a plain loop, compiled for the vectors of this machine.
struct Brightness<'a, V> {
    pixels: &'a [u32],
    now: V,
    levels: &'a mut Vec<f32>,
}

impl<V: View> WithSimd for Brightness<'_, V> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Brightness { pixels, now, levels } = self;
        levels.clear();
        levels.resize(pixels.len(), 0.0);
        for (level, &pixel) in levels.iter_mut().zip(pixels) {
            *level = now.at(pixel % WIDTH as u32, pixel / WIDTH as u32);
        }
    }
}

/// State of a camera.
#[derive(Debug, Clone)]
pub struct Camera {
    pixels: Pixels,
    draws: Draws,
    state: Vec<Pixel>,
    /// Pixels whose remaining change reaches the threshold.
    behind: Vec<u32>,
    /// Bit masks of spiking units, by polarity: falls, rises.
    spiking: [Vec<u64>; 2],
    step: u16,
    arch: Arch,
    /// Pixels of a tick, and their brightness.
    checked: Vec<u32>,
    levels: Vec<f32>,
}

impl Camera {
    /// A camera before its first tick. Thresholds are the same for every sample.
    pub fn new(pixels: &Pixels, draws: Draws) -> Self {
        let pixel = Pixel { reference: 0.0, threshold: 0.0, free_at: 0, seen: false };
        Camera {
            pixels: pixels.clone(),
            draws,
            state: vec![pixel; WIDTH * HEIGHT],
            behind: Vec::new(),
            spiking: [vec![0; POOLED.div_ceil(64)], vec![0; POOLED.div_ceil(64)]],
            step: 0,
            arch: Arch::new(),
            checked: Vec::new(),
            levels: Vec::new(),
        }
    }

    /// Runs one tick over the pixels in `changed`, which may repeat. `at_rest` and `now` return a
    /// pixel's brightness at rest and now. Calls `spike` for each pooled unit that spikes,
    /// ascending, with its polarities.
    pub fn step(
        &mut self,
        changed: &[u32],
        at_rest: impl View,
        now: impl View,
        mut spike: impl FnMut(u32, Polarities),
    ) {
        let rest = self.pixels.refractory_ms.div_ceil(self.pixels.tick_ms);
        self.checked.clear();
        self.checked.extend(changed.iter().chain(&self.behind));
        self.behind.clear();
        self.arch.dispatch(Brightness { pixels: &self.checked, now, levels: &mut self.levels });
        for (&pixel, &level) in self.checked.iter().zip(&self.levels) {
            let (x, y) = (pixel % WIDTH as u32, pixel / WIDTH as u32);
            let state = &mut self.state[pixel as usize];
            if !state.seen {
                let gain = 1.0 + self.pixels.mismatch * Draws::DEVICE.normal(Purpose::PixelGain, pixel, 0);
                *state = Pixel {
                    reference: at_rest.at(x, y),
                    threshold: (self.pixels.contrast * gain.max(0.2)) as f32,
                    free_at: state.free_at,
                    seen: true,
                };
            }
            let change = level - state.reference;
            if change.abs() < state.threshold {
                continue;
            }
            if self.step >= state.free_at {
                state.reference += if change > 0.0 { state.threshold } else { -state.threshold };
                state.free_at = self.step + rest;
                let unit = pooled(x as usize, y as usize);
                self.spiking[usize::from(change > 0.0)][unit / 64] |= 1 << (unit % 64);
            }
            // A remaining difference is checked again when the refractory time is over.
            if (level - state.reference).abs() >= state.threshold {
                self.behind.push(pixel);
            }
        }
        self.behind.sort_unstable();
        self.behind.dedup();
        let mean = self.pixels.noise_hz * 1e-3 * f64::from(self.pixels.tick_ms) * (WIDTH * HEIGHT) as f64;
        for k in 0..self.draws.poisson(Purpose::PixelNoiseCount, 0, u32::from(self.step), mean) {
            let pixel = self.draws.unit(Purpose::PixelNoise, k, u32::from(self.step)) * (WIDTH * HEIGHT) as f64;
            let state = &mut self.state[pixel as usize];
            if self.step >= state.free_at {
                state.free_at = self.step + rest;
                let unit = pooled(pixel as usize % WIDTH, pixel as usize / WIDTH);
                let rises = self.draws.unit(Purpose::PixelNoisePolarity, k, u32::from(self.step)) < 0.5;
                self.spiking[usize::from(rises)][unit / 64] |= 1 << (unit % 64);
            }
        }
        let [falls, rises] = &mut self.spiking;
        for (word, (falls, rises)) in falls.iter_mut().zip(rises).enumerate() {
            let mut either = *falls | *rises;
            while either != 0 {
                let bit = either.trailing_zeros();
                let polarities = Polarities { falls: *falls >> bit & 1 == 1, rises: *rises >> bit & 1 == 1 };
                spike(word as u32 * 64 + bit, polarities);
                either &= either - 1;
            }
            (*falls, *rises) = (0, 0);
        }
        self.step += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(pixels: &Pixels) -> Camera {
        Camera::new(pixels, Draws::new(1, 0))
    }

    const STILL: Pixels = Pixels { contrast: 0.2, mismatch: 0.0, refractory_ms: 2, noise_hz: 0.0, tick_ms: 1 };

    #[test]
    fn pooling_covers_each_pixel_once_in_rows_of_fifty() {
        assert_eq!((POOLED_WIDTH, POOLED_HEIGHT, POOLED), (50, 63, 3150));
        let mut pixels = vec![0; POOLED];
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                pixels[pooled(x, y)] += 1;
                // By definition unit (r, c) sees rows 4 r to 4 r + 3, columns 4 c to 4 c + 3.
                let (row, column) = (pooled(x, y) / 50, pooled(x, y) % 50);
                assert!((4 * row..4 * row + 4).contains(&y) && (4 * column..4 * column + 4).contains(&x));
            }
        }
        assert!(pixels[..62 * 50].iter().all(|&n| n == 16) && pixels[62 * 50..].iter().all(|&n| n == 8));
    }

    #[test]
    fn events_follow_the_contrast_threshold_and_the_refractory_time() {
        // A step of 0.7 is three events of 0.2, which come every 2 ms: in steps 3, 5 and 7.
        let mut camera = camera(&STILL);
        let pixel = (13 * WIDTH + 21) as u32;
        let mut spikes = Vec::new();
        for step in 0..20 {
            let level = if step < 3 { 1.0 } else { 1.7 };
            // A repeated pixel changes nothing.
            let changed = if step == 3 { vec![pixel, pixel] } else { Vec::new() };
            camera.step(&changed, |_, _| 1.0, |_, _| level, |unit, _| spikes.push((step, unit)));
        }
        let unit = pooled(21, 13) as u32;
        assert_eq!(spikes, [(3, unit), (5, unit), (7, unit)]);
    }

    #[test]
    fn pixels_of_a_unit_make_one_spike_of_either_polarity() {
        let mut camera = camera(&STILL);
        let block: Vec<u32> = (0..4).flat_map(|y| (0..4).map(move |x| (y * WIDTH + x) as u32)).collect();
        let mut spikes = Vec::new();
        let mut see = |unit, polarities: Polarities| spikes.push((unit, polarities.planes().collect::<Vec<_>>()));
        camera.step(&block, |_, _| 0.0, |x, _| if x % 2 == 0 { 0.3 } else { -0.3 }, &mut see);
        // Refractory for a step; then the odd columns return.
        camera.step(&[], |_, _| 0.0, |_, _| 0.0, &mut see);
        camera.step(&block, |_, _| 0.0, |x, _| if x % 2 == 0 { 0.3 } else { 0.0 }, &mut see);
        assert_eq!(spikes, [(0, vec![0, 1]), (0, vec![1])]);
    }

    #[test]
    fn noise_comes_at_its_rate() {
        let mut camera = camera(&Pixels { noise_hz: 0.5, ..STILL });
        let mut spikes = 0;
        for _ in 0..400 {
            camera.step(&[], |_, _| 0.0, |_, _| 0.0, |_, _| spikes += 1);
        }
        // 50,000 pixels x 0.5 Hz x 0.4 s = 10,000 events; at 25 a step some share a unit.
        assert!((9_600..10_050).contains(&spikes), "{spikes}");
    }
}
