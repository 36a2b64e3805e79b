//! Values of scene parameters.
//!
//! Input: a key, its value as text and the range allowed. Output: a number, or a range of numbers.
//! Errors: `scene.parameter`.

use nsim_ir::base::diagnostic::{Diagnostic, Result};

pub(super) fn parameter<T: std::str::FromStr + PartialOrd + std::fmt::Display>(
    key: &str,
    value: &str,
    range: std::ops::RangeInclusive<T>,
) -> Result<T> {
    value.parse().ok().filter(|parsed| range.contains(parsed)).ok_or_else(|| {
        Diagnostic::new(
            "scene.parameter",
            format!("scene parameter {key}={value} is not within {}..={}", range.start(), range.end()),
        )
    })
}

/// A parameter that is random for each sample: `low..high` or one value for all, within a range.
pub(super) fn spread(key: &str, value: &str, range: std::ops::RangeInclusive<f64>) -> Result<(f64, f64)> {
    let (low, high) = value.split_once("..").unwrap_or((value, value));
    let (low, high) = (parameter(key, low, range.clone())?, parameter(key, high, range)?);
    if low > high {
        return Err(Diagnostic::new(
            "scene.parameter",
            format!("scene parameter {key}={value} has a low end above its high end"),
        )
        .help("write low..high"));
    }
    Ok((low, high))
}

/// Error for a key that the scene does not have; its help lists the keys.
pub(super) fn unknown(scene: &str, key: &str, keys: &[&str]) -> Diagnostic {
    Diagnostic::new("scene.parameter", format!("scene {scene} has no parameter '{key}'"))
        .help(format!("parameters are: {}", keys.join(", ")))
}

/// Declares a scene that fingers and a camera record. Each of its own parameters has a doc comment,
/// a type, a default, a reader and a range. Number of samples, seed, taxels, pixels and wire are
/// parameters of every such scene.
macro_rules! parameters {
    (
        $name:literal, $(#[$about:meta])* pub struct $scene:ident { skin: $skin:expr, pixels: $pixels:expr }
        $($(#[$of:meta])* $own:ident: $type:ty = $default:expr, $read:ident($range:expr);)*
    ) => {
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $scene {
            /// Number of samples.
            pub samples: u32,
            /// Seed of the samples' random numbers.
            pub seed: u64,
            $($(#[$of])* pub $own: $type,)*
            /// The taxels.
            pub skin: Skin,
            /// The camera's pixels.
            pub pixels: Pixels,
            /// The wire that all taxels share; none when each has its own.
            pub wire: Option<Wire>,
        }

        impl Default for $scene {
            fn default() -> Self {
                $scene { samples: 20, seed: 1, $($own: $default,)* skin: $skin, pixels: $pixels, wire: None }
            }
        }

        parameters! {
            @parse $name, $scene, set;
            samples = parameter(1..=crate::recording::MOST_SAMPLES) => set.samples,
            seed = parameter(0..=u64::MAX) => set.seed,
            $($own = $read($range) => set.$own,)*
            threshold_kpa = parameter(0.001..=1000.0) => set.skin.threshold_kpa,
            touch_noise_kpa = parameter(0.0..=1000.0) => set.skin.noise_kpa,
            touch_refractory_ms = parameter(1..=1000) => set.skin.refractory_ms,
            adaptation_ms = parameter(1.0..=1e6) => set.skin.adaptation_ms,
            contrast = parameter(0.01..=10.0) => set.pixels.contrast,
            pixel_refractory_ms = parameter(1..=1000) => set.pixels.refractory_ms,
            pixel_noise_hz = parameter(0.0..=100.0) => set.pixels.noise_hz,
            aces_noise = parameter(0.0..=10.0) => set.wire.get_or_insert_default().noise,
            aces_jitter_us = parameter(0..=crate::wire::MOST_JITTER) => set.wire.get_or_insert_default().jitter_us,
        }
    };
    (@parse $name:literal, $scene:ident, $set:ident; $($key:ident = $read:ident($range:expr) => $field:expr,)*) => {
        impl $scene {
            /// The parameters that can be set.
            pub const KEYS: &[&str] = &[$(stringify!($key)),*];

            /// Reads `scene:NAME?key=value&..`; a parameter that is random for each sample is a
            /// value or `low..high`.
            ///
            /// # Errors
            /// `scene.parameter` for an unknown key or a value out of range.
            pub fn parse(scene: &SceneArg) -> Result<Self> {
                let mut $set = Self::default();
                for (key, value) in &scene.parameters {
                    match key.as_str() {
                        $(stringify!($key) => $field = $read(key, value, $range)?,)*
                        _ => return Err(unknown($name, key, Self::KEYS)),
                    }
                }
                Ok($set)
            }
        }
    };
}
pub(super) use parameters;
