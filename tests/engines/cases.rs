//! Stages of the compiler on the models of `tests/cases`, compared with their stored results.
//!
//! `tests/cases/STAGE/NAME.ron` is a model file. Its first lines describe its purpose; a line that
//! begins with `// options: ` has the options of the stage. `NAME.out.ron` is the result of the
//! stage, or the reason for its refusal. `NSIM_BLESS=1` writes these files anew.

use std::collections::BTreeMap;
use std::path::Path;

use nsim::compile::{CompileError, Options, compile};
use nsim::files::lower::lower;
use nsim::files::mapping::pretty;
use nsim::files::network::{Network, NetworkFile};
use nsim::files::shipped::Origin;
use nsim::files::target::target;
use nsim::ir::base::diagnostic::{Diagnostic, SourceText};
use nsim::ir::base::id::{IdVec, PopulationId, ProjectionId};
use nsim::ir::pruned::Row;
use nsim::ir::quantised::{Population, Projection, Quantised};
use nsim::ir::resource::LimitChanges;
use nsim::ir::spanned::parse;
use nsim::quantise::integers;
use nsim::quantise::prune::{Plan, prune};
use serde::{Deserialize, Serialize};

/// Options of a stage.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Call {
    /// Chips of Loihi 1 from west to east.
    chips: u32,
    /// Limits of a core that differ from Loihi 1's.
    limits: LimitChanges,
    copies: u32,
    /// Probed populations.
    probed: Vec<String>,
}

impl Default for Call {
    fn default() -> Self {
        Call { chips: 1, limits: LimitChanges::default(), copies: 1, probed: Vec::new() }
    }
}

/// The pruned network, and the record of removed parts.
#[derive(Serialize)]
struct Pruned<'a> {
    rows: &'a [Row],
    populations: &'a IdVec<PopulationId, Population>,
    projections: &'a IdVec<ProjectionId, Projection>,
}

/// Reasons for which a stage refuses a model.
#[derive(Serialize)]
struct Refused(Vec<String>);

impl From<Diagnostic> for Refused {
    fn from(problem: Diagnostic) -> Self {
        Refused(vec![problem.to_string()])
    }
}

fn quantised(source: SourceText) -> Result<Quantised, Diagnostic> {
    integers(&lower(&Network::new(NetworkFile::parse(&source)?, source, BTreeMap::new())?)?)
}

/// The result of a stage on a model, as text.
fn made(stage: &str, model: SourceText, call: &Call) -> Result<String, Refused> {
    let network = quantised(model)?;
    let board = format!("Target(base: \"loihi1-chip\", chips_x: {})", call.chips);
    let board = target(&SourceText::new("board.ron", board), Origin::File)?;
    let board = board.clone().with_limits(call.limits.applied(board.limits().clone()));
    let compiled = |network| match compile(network, &board, &Options { copies: call.copies, ..Options::default() }) {
        Ok(compiled) => Ok(compiled.partition),
        Err(CompileError::DoesNotFit(reasons)) => {
            Err(Refused(reasons.iter().map(|reason| format!("{}: {reason}", reason.code)).collect()))
        }
        Err(other) => Err(Refused(vec![other.to_string()])),
    };
    match stage {
        "quantise" => Ok(pretty(&network, 3)?),
        "prune" => {
            let probed = call.probed.iter().map(|name| network.population_named(name).unwrap());
            let pruned = prune(&network, &Plan::fixed().probing(probed)).map_err(|wrong| Refused(vec![wrong.0]))?;
            compiled(pruned.clone())?;
            let (populations, projections) = (pruned.populations(), pruned.projections());
            Ok(pretty(&Pruned { rows: &pruned.pruned().unwrap().rows, populations, projections }, 2)?)
        }
        "compile" => Ok(pretty(compiled(network)?.usage(), 1)?),
        other => panic!("tests/cases/{other} is no stage"),
    }
}

#[test]
fn stages_make_of_their_cases_what_they_made_before() {
    let bless = std::env::var_os("NSIM_BLESS").is_some_and(|value| value == "1");
    let (mut number, mut differing) = (0, Vec::new());
    for folder in Path::new("tests/cases").read_dir().unwrap() {
        let folder = folder.unwrap();
        for path in folder.path().read_dir().unwrap() {
            let path = path.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if name.ends_with(".out.ron") {
                assert!(path.with_file_name(name.replace(".out.ron", ".ron")).exists(), "{name} is of no case");
                continue;
            }
            let model = std::fs::read_to_string(&path).unwrap();
            let options = model.lines().find_map(|line| line.strip_prefix("// options: "));
            let call = |options| parse(&SourceText::new(&*name, options), "case.options").unwrap();
            let call = options.map_or_else(Call::default, call);
            let stage = folder.file_name().to_string_lossy().into_owned();
            let out = made(&stage, SourceText::new(&*name, model), &call)
                .unwrap_or_else(|refused| pretty(&refused, 2).unwrap());
            let kept = path.with_extension("out.ron");
            if bless {
                std::fs::write(&kept, &out).unwrap();
            }
            if std::fs::read_to_string(&kept).unwrap_or_default() != out {
                differing.push(format!("{}:\n{out}", kept.display()));
            }
            number += 1;
        }
    }
    let help = "look at the difference; NSIM_BLESS=1 cargo test --test engines cases:: writes the files anew";
    assert!(differing.is_empty() && number > 20, "{number} cases; {help}\n{}", differing.join("\n"));
}
