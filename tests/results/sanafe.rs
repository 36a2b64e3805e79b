//! Energy and time of random mapped networks against SANA-FE, if a Python has it.

use crate::common;
use std::process::Command;

/// `NSIM_SANAFE` names a Python with `sanafe` 2.2 and numpy; without one the comparison is skipped.
#[test]
fn energy_is_equal_and_queued_time_within_three_percent() {
    let Some(python) = std::env::var_os("NSIM_SANAFE") else {
        common::say("skipped: NSIM_SANAFE names no Python with sanafe (pip install sanafe numpy)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check_sanafe.py");
    let output = Command::new(python).arg(script).arg(env!("CARGO_BIN_EXE_nsim")).arg(folder.path()).output().unwrap();
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
