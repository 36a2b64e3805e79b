//! Published workloads, checked.
//!
//! Input: the name of a shipped workload. Output: a [`WorkloadFile`] whose shapes and rates are
//! possible and whose projections join populations that it has. Errors: `workload.syntax`,
//! `workload.population`, `workload.rate`, `workload.figure`.

use crate::published::workload::{Between, WorkloadDeployment, WorkloadFile, WorkloadPopulation};
use nsim_files::shipped;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::spanned::parse;

/// The most units of a population.
const MOST_UNITS: u64 = 1 << 22;

fn is_ordered(range: Between) -> bool {
    0.0 <= range.low && range.low <= range.value && range.value <= range.high
}

/// Every workload that ships, in the order in which tables show them.
///
/// # Errors
/// As [`workload`].
pub fn shipped() -> Result<Vec<WorkloadFile>> {
    shipped::WORKLOADS.iter().map(|file| workload(&file.source())).collect()
}

/// A workload from its text.
///
/// # Errors
/// A diagnostic where the file is malformed or contradicts itself.
pub fn workload(source: &SourceText) -> Result<WorkloadFile> {
    let file: WorkloadFile = parse(source, "workload.syntax")?;
    let wrong = |code, message: String| Err(Diagnostic::new(code, message).in_file(source.path()));
    for population in &file.populations {
        let (name, shape, rate) = population.parts();
        let units: u64 = shape.iter().map(|&side| u64::from(side)).product();
        if !matches!(shape.len(), 1 | 3) || !(1..=MOST_UNITS).contains(&units) {
            return wrong("workload.population", format!("{name}: a shape is one number or three, at most 2^22 units"));
        }
        if rate.is_some_and(|rate| !is_ordered(rate) || rate.high > 0.5) {
            return wrong("workload.rate", format!("{name}: rates are 0 <= low <= value <= high <= 0.5"));
        }
        if let WorkloadPopulation::Relay { of, .. } = population {
            let is_source = |other: &WorkloadPopulation| {
                let (own, of_shape, _) = other.parts();
                matches!(other, WorkloadPopulation::Input { .. }) && own == of && of_shape == shape
            };
            if !file.populations.iter().any(is_source) {
                return wrong("workload.population", format!("{name}: there is no input population {of} of its shape"));
            }
        }
    }
    for projection in &file.projections {
        for end in projection.ends() {
            if !file.populations.iter().any(|population| population.parts().0 == end) {
                return wrong("workload.population", format!("there is no population {end}"));
            }
        }
    }
    if let Some(figure) = file.figures.iter().find(|figure| !figure.published.value.is_finite()) {
        let problem = Diagnostic::new("workload.figure", "a figure is a finite number");
        return Err(problem.at(source, figure.published.span));
    }
    if !is_ordered(file.active_share) || file.active_share.high > 1.0 {
        return wrong("workload.rate", "active_share is 0 <= low <= value <= high <= 1".to_string());
    }
    let mut placed: Vec<&str> = Vec::new();
    for name in file.layout.iter().flat_map(|part| &part.layers) {
        let is_layer = |other: &WorkloadPopulation| {
            !matches!(other, WorkloadPopulation::Input { .. }) && other.parts().0 == name.value
        };
        if placed.contains(&name.value.as_str()) || !file.populations.iter().any(is_layer) {
            let message = format!("{} is no layer, or is on cores twice", name.value);
            return Err(Diagnostic::new("workload.layout", message).at(source, name.span));
        }
        placed.push(&name.value);
    }
    let layers = file.populations.iter().filter(|one| !matches!(one, WorkloadPopulation::Input { .. })).count();
    if placed.len() != layers || file.layout.iter().any(|part| part.cores == 0) {
        return wrong("workload.layout", "every layer is on one core at least".to_string());
    }
    let WorkloadDeployment { copies, cores_used, chips_used, board_chips, .. } = file.deployment;
    if copies == 0 || file.steps == 0 || cores_used == 0 || chips_used == 0 || chips_used > board_chips {
        let message = "copies, cores, chips and steps are at least 1, chips in use at most those of the board";
        return wrong("workload.figure", message.to_string());
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::hardware::constants::Status;

    #[test]
    fn shipped_workloads_are_well_formed_and_say_what_was_assumed() {
        let all = shipped().unwrap();
        let works: std::collections::BTreeSet<&str> =
            all.iter().filter(|file| file.first_hand).map(|file| file.work.as_str()).collect();
        assert!(works.len() >= 10, "{works:?}");
        for file in &all {
            assert!(!file.figures.is_empty() && !file.source.is_empty(), "{}", file.name);
            assert!(file.activity == Status::Published || !file.assumed.is_empty(), "{}", file.name);
            nsim_files::target::load_target(&file.target.value).unwrap();
        }
    }
}
