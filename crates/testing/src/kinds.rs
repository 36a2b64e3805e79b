//! Kinds of neurons of Loihi 2 as model files state them, each with the parameters of the kind that
//! nsim has, in their order.

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

/// A kind as a model file states it; itself where there is no such text.
///
/// # Panics
/// When the text of a kind is wrong.
#[must_use]
pub fn stated(kind: NeuronKind) -> NeuronKind {
    let source = SourceText::new("kinds.ron", KINDS.replace("RESONATOR", RESONATOR));
    let kinds: Vec<MicrocodeKind> = parse(&source, "kinds").expect("kinds that hold");
    let own = kinds.into_iter().find(|own| own.name().strip_prefix("Own") == Some(kind.name()));
    own.map_or(kind, NeuronKind::Microcode)
}
