//! The memory of this process, for tests that bound it.

/// The most memory that this process ever held, in KiB; nothing where no /proc says so.
pub fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}
