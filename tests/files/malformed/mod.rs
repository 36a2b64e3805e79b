//! Damaged, hostile or wrong files. Each is refused with a code, words and a line that help its
//! user to correct it. None panics, none takes more memory than a small multiple of its size.

use crate::memory;
mod cases;

use std::path::{Path, PathBuf};

use self::cases::{Case, Through, cases};
use nsim::files::lower::lower;
use nsim::files::target::load_target;
use nsim::import::model::load_model;
use nsim::import::spikes::read_source;
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::quantise::quantise::quantise;

/// Channels of the population that receives the spike files.
const UNITS: u64 = 4;

fn lay_out(folder: &Path, case: &Case) -> PathBuf {
    for (name, bytes) in &case.beside {
        std::fs::write(folder.join(name), bytes).expect("a temporary folder takes files");
    }
    let path = folder.join(case.file);
    std::fs::write(&path, &case.bytes).expect("a temporary folder takes files");
    path
}

fn through_the_library(case: &Case, path: &Path) -> Result<(), Diagnostic> {
    let argument = path.to_str().expect("a plain path");
    match case.through {
        Through::Model => quantise(&lower(&load_model(argument)?)?).map(drop),
        Through::Target => load_target(argument).map(drop),
        Through::Spikes => read_source(path, UNITS).map(drop),
    }
}

#[test]
fn each_is_refused_by_name_and_place() {
    memory::alone(module_path!(), "each_is_refused_by_name_and_place", |growth| {
        let cases = cases();
        assert!(cases.len() >= 45, "{} cases", cases.len());
        let mut wrong = Vec::new();
        for case in &cases {
            let folder = tempfile::tempdir().unwrap();
            let path = lay_out(folder.path(), case);
            let Err(problem) = through_the_library(case, &path) else {
                wrong.push(format!("{}: accepted", case.name));
                continue;
            };
            let line = problem.position().map(|position| position.line);
            let said = format!("{problem} {}", problem.help.as_deref().unwrap_or_default());
            if problem.code != case.code || line != case.line || !said.contains(case.says) {
                wrong.push(format!(
                    "{}: {} at {line:?}: {said}\n    expected {} at {:?}: {}",
                    case.name, problem.code, case.code, case.line, case.says
                ));
            }
            if problem.file().is_none() {
                wrong.push(format!("{}: no file is named: {problem}", case.name));
            }
        }
        assert!(wrong.is_empty(), "{} of {}:\n{}", wrong.len(), cases.len(), wrong.join("\n"));
        assert!(growth.kib().is_none_or(|grown| grown < 1 << 20), "the bound is 1 GiB");
    });
}

#[test]
fn what_they_were_made_from_is_accepted() {
    let folder = tempfile::tempdir().unwrap();
    for case in cases::sound() {
        let path = lay_out(folder.path(), &case);
        through_the_library(&case, &path).unwrap_or_else(|problem| panic!("{}: {problem}", case.name));
    }
}

/// Small changes anywhere in a valid file are accepted or refused, and never crash the reader.
#[test]
fn random_damage_never_panics() {
    let sound = cases::sound();
    let model = &sound[0];
    let folder = tempfile::tempdir().unwrap();
    let draw = |round: u64, which: u64, n: usize| (nsim::ir::base::rng::unit(11, round, which) * n as f64) as usize;
    let mut refused = 0;
    for round in 0..3000 {
        let mut bytes = model.bytes.clone();
        for change in 0..=draw(round, 0, 3) as u64 {
            let (at, from) = (draw(round, 4 * change + 1, bytes.len()), draw(round, 4 * change + 2, bytes.len()));
            match draw(round, 4 * change + 3, 4) {
                0 => bytes[at] = draw(round, 4 * change + 4, 256) as u8,
                1 => bytes.truncate(at.max(1)),
                2 => drop(bytes.remove(at)),
                _ => bytes.insert(at, bytes[from.min(bytes.len() - 1)]),
            }
            if bytes.len() < 2 {
                break;
            }
        }
        let case = Case { bytes, ..model.clone() };
        refused += u32::from(through_the_library(&case, &lay_out(folder.path(), &case)).is_err());
    }
    assert!((1500..3000).contains(&refused), "{refused} of 3000 refused");
}

/// The cases through the program: exit status 3, the code in its JSON, and no panic.
#[test]
fn the_program_exits_with_3_and_names_the_code() {
    let mut wrong = Vec::new();
    for case in &cases() {
        let folder = tempfile::tempdir().unwrap();
        let path = lay_out(folder.path(), case);
        let sound = folder.path().join("sound.ron");
        std::fs::write(&sound, cases::MODEL).unwrap();
        let mut command = assert_cmd::Command::cargo_bin("nsim").unwrap();
        match case.through {
            Through::Model => command.arg("map").arg(&path),
            Through::Target => command.arg("map").arg(&sound).arg("--target").arg(&path),
            Through::Spikes => command.arg("run").arg(&sound).arg("--target").arg("tiny").arg("--input").arg(&path),
        };
        let output = command.arg("--format").arg("json").timeout(std::time::Duration::from_secs(120)).output().unwrap();
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        let named = said.contains("nsim.error/1") && said.contains(&format!("\"{}\"", case.code));
        if output.status.code() != Some(3) || !named || said.contains("panicked") {
            wrong.push(format!("{}: exit {:?}: {said}", case.name, output.status.code()));
        }
    }
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
}
