//! The neuron kinds that a model file declares, available while its populations are parsed.

use std::cell::RefCell;
use std::collections::BTreeMap;

use nsim_ir::neurons::MicrocodeKind;

thread_local! {
    /// The kinds that the text states which this thread is reading, by name.
    static KINDS: RefCell<BTreeMap<&'static str, MicrocodeKind>> = const { RefCell::new(BTreeMap::new()) };
}

/// Runs `read`; its populations may be of these kinds or of the built-in ones.
pub(super) fn with_kinds<T>(kinds: &[MicrocodeKind], read: impl FnOnce() -> T) -> T {
    let before = KINDS.replace(kinds.iter().map(|kind| (kind.name(), *kind)).collect());
    let result = read();
    KINDS.set(before);
    result
}

/// The kind of this name that the text states which this thread is reading.
pub(super) fn stated_kind(name: &str) -> Option<MicrocodeKind> {
    KINDS.with_borrow(|kinds| kinds.get(name).copied())
}

/// The names of all of them, ascending.
pub(super) fn stated_names() -> Vec<&'static str> {
    KINDS.with_borrow(|kinds| kinds.keys().copied().collect())
}
