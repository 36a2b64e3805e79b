//! Loihi 2 neuron kinds, declared as in a model file, with the parameters of nsim's built-in kinds
//! in their order.

use nsim_ir::base::diagnostic::SourceText;
use nsim_ir::neurons::{MicrocodeKind, NeuronKind};
use nsim_ir::spanned::parse;

const KINDS: &str = r#"[
    Kind(
        name: "OwnSigmaDelta",
        state: [
            (name: "sigma", bits: 32, overflow: Wrap),
            (name: "act", bits: 32, overflow: Wrap),
            (name: "residue", bits: 32, overflow: Wrap),
            (name: "error", bits: 32, overflow: Wrap),
        ],
        parameters: [
            (name: "vth_mant", range: (0, 131071)),
            (name: "bias_mant", range: (-131072, 131071), default: 0),
            (name: "spike_exp", range: (0, 7), default: 0),
            (name: "state_exp", range: (0, 7), default: 0),
            (name: "relu", range: (0, 1), default: 0),
            (name: "cum_error", range: (0, 1), default: 0),
            (name: "corrected", range: (0, 1), default: 0),
        ],
        temporaries: [
            (name: "x", bits: 32, overflow: Wrap),
            (name: "d", bits: 32, overflow: Wrap),
            (name: "e", bits: 32, overflow: Wrap),
            (name: "kept", bits: 32, overflow: Wrap),
        ],
        update: [
            "k = spike_exp + state_exp",
            "cumulates = cum_error and not corrected",
            "sigma = sigma + in",
            "x = sigma + (bias_mant << k)",
            "x = max(x, select(relu, 0, -2147483648))",
            "d = x - act",
            "d = d + residue",
            "e = error + select(cumulates, d, 0)",
            "c = select(cumulates, e, d)",
            "s = select(c >= vth_mant << k or c <= -(vth_mant << k), d, 0)",
            "m = s >> state_exp",
            "error = select(s, 0, e)",
            "residue = select(corrected or s, 0, d)",
            "kept = act + select(corrected, wrap(m << state_exp, 32), 0)",
            "act = select(corrected, kept, x)",
        ],
        message: "m",
    ),
    Kind(
        name: "OwnDelta",
        state: [
            (name: "act", bits: 32, overflow: Wrap),
            (name: "residue", bits: 32, overflow: Wrap),
            (name: "error", bits: 32, overflow: Wrap),
        ],
        parameters: [
            (name: "vth_mant", range: (0, 131071)),
            (name: "spike_exp", range: (0, 7), default: 0),
            (name: "state_exp", range: (0, 7), default: 0),
            (name: "cum_error", range: (0, 1), default: 0),
        ],
        temporaries: [
            (name: "x", bits: 32, overflow: Wrap),
            (name: "d", bits: 32, overflow: Wrap),
            (name: "e", bits: 32, overflow: Wrap),
        ],
        update: [
            "k = spike_exp + state_exp",
            "x = in << k",
            "d = x - act",
            "d = d + residue",
            "e = error + select(cum_error, d, 0)",
            "c = select(cum_error, e, d)",
            "s = select(c >= vth_mant << k or c <= -(vth_mant << k), d, 0)",
            "error = select(s, 0, e)",
            "residue = select(s, 0, d)",
            "act = x",
        ],
        message: "s >> state_exp",
    ),
    Kind(
        name: "OwnSigma",
        state: [(name: "sigma", bits: 32, overflow: Wrap)],
        update: ["sigma = sigma + in"],
        message: "sigma",
    ),
    Kind(
        name: "OwnRf",
        RESONATOR
        update: [
            "x = tz(cos_decay * re, decay_bits) - tz(sin_decay * im, decay_bits) + (in << state_exp)",
            "y = tz(sin_decay * re, decay_bits) + tz(cos_decay * im, decay_bits) + (in2 << state_exp)",
            "before = im",
            "re = x",
            "im = y",
        ],
        spikes: "re >= threshold and im >= 0 and before < 0",
    ),
    Kind(
        name: "OwnRfIz",
        RESONATOR
        update: [
            "x = tz(cos_decay * re, decay_bits) - tz(sin_decay * im, decay_bits) + (in << state_exp)",
            "im = tz(sin_decay * re, decay_bits) + tz(cos_decay * im, decay_bits) + (in2 << state_exp)",
            "re = x",
        ],
        spikes: "im >= threshold",
        reset: ["re = 0", "im = threshold - 1"],
    ),
    Kind(
        name: "OwnAlifAbove",
        state: [
            (name: "u", bits: 32, overflow: Wrap),
            (name: "v", bits: 32, overflow: Wrap),
            (name: "above", bits: 32, overflow: Wrap),
            (name: "r", bits: 32, overflow: Wrap),
        ],
        parameters: [
            (name: "du", range: (0, 4096)),
            (name: "dv", range: (0, 4096)),
            (name: "dtheta", range: (0, 4096)),
            (name: "dr", range: (0, 4096)),
            (name: "threshold", range: (0, 1073741823)),
            (name: "threshold_step", range: (-1073741824, 1073741823)),
        ],
        update: [
            "u = tz(u * (4096 - du), 12) + (in << 6)",
            "v = tz(v * (4096 - dv), 12) + u",
            "above = tz(above * (4096 - dtheta), 12)",
            "r = tz(r * (4096 - dr), 12)",
        ],
        spikes: "v - r >= above + threshold",
        reset: ["r = r + 2 * (above + threshold)", "above = above + threshold_step"],
    ),
    Kind(
        name: "OwnDeltaEncoder",
        state: [
            (name: "act", bits: 32, overflow: Wrap),
            (name: "residue", bits: 32, overflow: Wrap),
            (name: "next", bits: 32, overflow: Wrap),
        ],
        parameters: [
            (name: "vth_mant", range: (0, 131071)),
            (name: "spike_exp", range: (0, 7), default: 0),
            (name: "low", range: (-2147483648, 0), default: -2147483648),
            (name: "high", range: (0, 2147483647), default: 2147483647),
        ],
        temporaries: [(name: "x", bits: 32, overflow: Wrap), (name: "d", bits: 32, overflow: Wrap)],
        update: [
            "late = next",
            "x = in << spike_exp",
            "d = x - act + residue",
            "s = select(d >= vth_mant << spike_exp or d <= -(vth_mant << spike_exp), d, 0)",
            "next = max(min(s, high), low)",
            "residue = d - next",
            "act = x",
        ],
        message: "late",
    ),
]"#;

/// State and parameters of both resonators.
const RESONATOR: &str = r#"state: [(name: "re", bits: 24, overflow: Clip), (name: "im", bits: 24, overflow: Clip)],
        parameters: [
            (name: "sin_decay", range: (-32768, 32767)),
            (name: "cos_decay", range: (-32768, 32767)),
            (name: "threshold", range: (0, 8388607)),
            (name: "state_exp", range: (0, 7), default: 0),
            (name: "decay_bits", range: (1, 15), default: 12),
        ],"#;

/// Returns the declared form of a kind, or the kind itself where there is none.
///
/// # Panics
/// When a declaration is invalid.
pub fn stated(kind: NeuronKind) -> NeuronKind {
    own(kind.name()).unwrap_or(kind)
}

/// Kind whose name is `Own` and `name`. `AlifAbove` is `Alif` with theta relative to its start.
/// `DeltaEncoder` is the encoder of lava's host with the limits of its messages.
///
/// # Panics
/// As [`stated`].
pub fn own(name: &str) -> Option<NeuronKind> {
    let source = SourceText::new("kinds.ron", KINDS.replace("RESONATOR", RESONATOR));
    let kinds: Vec<MicrocodeKind> = parse(&source, "kinds").expect("kinds that hold");
    kinds.into_iter().find(|own| own.name().strip_prefix("Own") == Some(name)).map(NeuronKind::Microcode)
}
