//! Commands run as processes, pages and pictures, and the examples of the documents.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

mod advice;
mod agreement;
mod book;
#[path = "../common/mod.rs"]
mod common;
mod compare;
mod convert;
mod energy;
mod errors;
mod examples;
mod growth;
mod jobs;
mod learning;
mod mapping;
mod neurobench;
mod options;
mod own_chip;
mod page;
mod pictures;
mod remedies;
mod results;
mod runs;
mod saved_mappings;
mod screens;
mod side_by_side;
mod sweep;
mod training;
mod warnings;

use assert_cmd::Command;
use common::command;
use serde_json::Value;
use std::path::Path;

fn nsim(arguments: &[&str]) -> Command {
    command::nsim(Path::new("."), arguments)
}

/// Runs a command; returns exit status, stdout and stderr.
fn said(arguments: &[&str]) -> (i32, String, String) {
    command::said(Path::new("."), arguments)
}

/// The output of a command that has to succeed.
fn succeeds(arguments: &[&str]) -> String {
    command::succeeds(Path::new("."), arguments)
}

/// The result object of a command that should end with `status`.
fn object(arguments: &[&str], status: i32) -> Value {
    command::object(Path::new("."), arguments, status)
}

fn has_keys(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some(), "no key {key} in {}", object["schema"]);
    }
}

const MODEL: &str = "Network(name: \"small\", timestep_ms: 1.0,
  populations: [Input(name: \"in\", shape: [3]), Loihi(name: \"hidden\", shape: [4], du: 1024, dv: 128, vth_mant: 10),
    Loihi(name: \"out\", shape: [2], du: 1024, dv: 128, vth_mant: 10)],
  projections: [Dense(from: [\"in\"], to: \"hidden\", weights: [[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]),
    Dense(from: [\"hidden\"], to: \"out\", weights: [[30, 0, 20, 2], [0, 40, -10, 8]])],
  output: \"out\", classes: [\"left\", \"right\"])";

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

const SRM: &str = "Network(name: \"srm\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [6]),
    Srm(name: \"hidden\", shape: [5], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10),
    Srm(name: \"out\", shape: [2], tau_sr_ms: 10, tau_ref_ms: 1, scale_ref: 2, theta: 10)],
  projections: [Dense(from: [\"in\"], to: \"hidden\", weights: Uniform(low: -1, high: 4, seed: 1)),
    Dense(from: [\"hidden\"], to: \"out\", weights: Uniform(low: -2, high: 4, seed: 2))], output: \"out\")";
