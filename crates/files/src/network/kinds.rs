//! The neuron kinds that a model file declares, available while its populations are parsed.

use std::cell::RefCell;

use nsim_ir::neurons::MicrocodeKind;

thread_local! {
    /// The kinds that the text states which this thread is reading.
    static KINDS: RefCell<Vec<MicrocodeKind>> = const { RefCell::new(Vec::new()) };
}

/// Runs `read`; its populations may be of these kinds or of the built-in ones.
pub(super) fn with_kinds<T>(kinds: &[MicrocodeKind], read: impl FnOnce() -> T) -> T {
    let before = KINDS.replace(kinds.to_vec());
    let found = read();
    KINDS.set(before);
    found
}

/// The kinds that the text states which this thread is reading.
pub(super) fn stated_here() -> Vec<MicrocodeKind> {
    KINDS.with_borrow(Vec::clone)
}
