//! What an operation on the file system is to whoever injects faults: its class, and how much of it
//! may happen.

/// The classes of operations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Operation {
    /// Bytes go to a file or to stdout.
    Write,
    /// Files and folders are made.
    Make,
    /// They are named, removed, brought to the disk.
    Change,
    /// Bytes come from a file.
    Read,
    /// Files are opened, looked at, listed.
    Look,
}

/// What an operation may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Extent {
    Whole,
    /// Half of the bytes.
    #[cfg(all(debug_assertions, unix))]
    Half,
    /// Half of the bytes, and the process ends.
    #[cfg(all(debug_assertions, unix))]
    Torn,
    /// No bytes, as at the end of a file.
    #[cfg(all(debug_assertions, unix))]
    Nothing,
}
