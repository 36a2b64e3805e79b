//! The kinds of neurons that a text states, known while its populations are read.

use std::cell::RefCell;

use nsim_ir::neurons::MicrocodeKind;

thread_local! {
    /// The kinds that the text states which this thread is reading.
    static KINDS: RefCell<Vec<MicrocodeKind>> = const { RefCell::new(Vec::new()) };
}

/// Reads populations that may be of these kinds besides those that have a name of their own.
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
