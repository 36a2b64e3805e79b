//! Where figures of time were measured.

use serde_json::{Value, json};

use crate::bench::Environment;

/// Where a figure of time was measured, as every `nsim.bench/1` says it.
pub(super) fn json(of: &Environment) -> Value {
    let Environment { cpu, cores, os, rustc, nsim, profile } = of;
    json!({ "cpu": cpu, "cores": cores, "os": os, "rustc": rustc, "nsim": nsim, "profile": profile })
}
