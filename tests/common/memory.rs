//! The memory of a test, measured in a separate process: other tests of a binary run in threads of
//! one process.

use std::process::Command;

/// Environment variable of the process that runs one test alone; its value is the test's name.
const ALONE: &str = "NSIM_TEST_ALONE";

/// Runs the body of a test in a process that runs nothing else, and passes it a meter of the growth
/// of that process. `module` and `test` are the path and the name of the calling test.
///
/// # Panics
/// If the body panics.
pub fn alone(module: &str, test: &str, body: impl FnOnce(&Growth)) {
    let within = module.split_once("::").map_or(String::new(), |(_, module)| format!("{module}::"));
    let test = &format!("{within}{test}");
    if std::env::var_os(ALONE).is_some_and(|name| name == test.as_str()) {
        return body(&Growth { before_kib: peak_kib() });
    }
    let program = std::env::current_exe().unwrap();
    let output =
        Command::new(program).args([test, "--exact", "--nocapture"]).env(ALONE, test).output().expect("a test starts");
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    println!("{out}");
    assert!(out.contains("1 passed"), "{test} alone: {}\n{out}\n{err}", output.status);
}

/// Growth of a process since the body began.
pub struct Growth {
    before_kib: Option<u64>,
}

impl Growth {
    /// Growth of the process's peak since the body began, in KiB. Without /proc it is none, with a
    /// message.
    pub fn kib(&self) -> Option<u64> {
        let grown = self.before_kib.zip(peak_kib()).map(|(before, after)| after - before);
        match grown {
            Some(kib) => println!("grown by {kib} KiB"),
            None => println!("skipped: no /proc/self/status says how much memory this takes"),
        }
        grown
    }
}

/// Peak memory of this process, in KiB.
fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}
