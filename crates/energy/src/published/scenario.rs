//! Scenario files (`mapping/scenarios`): a published job, with the numbers of cores that it ran on.
//!
//! Input: the text of a scenario, or the name of a shipped model. Output: a [`ScenarioFile`] whose
//! numbers of cores are possible and whose tables of measurements are shipped. Errors:
//! `scenario.syntax`, `scenario.number`, `scenario.measured`.

use serde::Deserialize;

use nsim_cost::job::DeployedCores;
use nsim_files::shipped;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::spanned::{Spanned, parse};

/// A scenario file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Scenario")]
pub struct ScenarioFile {
    /// The scenario's name.
    pub name: String,
    /// The model that ran.
    pub model: String,
    /// Channels of its input populations: networks with equal ones serve as well.
    #[serde(default)]
    pub inputs: Vec<u32>,
    /// The target that it ran on.
    pub target: String,
    /// Copies of the model on the target.
    pub copies: Spanned<u32>,
    /// Numbers of cores.
    pub deployment: Spanned<DeployedCores>,
    /// Whether each input channel had its own compartment, which forwards its spikes.
    #[serde(default)]
    pub input_relays: bool,
    /// Maximum number of compartments of a core, where the job placed fewer than fit.
    #[serde(default)]
    pub compartments_per_core: Option<u32>,
    /// Shipped tables of measurements of this job.
    #[serde(default)]
    pub measured: Vec<Spanned<String>>,
    /// Name of the publication, as used in sentences.
    pub work: String,
    /// Publication and table that state the numbers.
    pub source: String,
    /// Inferred details.
    pub notes: String,
}

impl ScenarioFile {
    /// Whether a network has the inputs of the job, or is its model.
    pub fn serves(&self, network: &Quantised) -> bool {
        let mut inputs: Vec<u32> = network.inputs().map(|(_, population)| population.shape.len()).collect();
        let mut own = self.inputs.clone();
        inputs.sort_unstable();
        own.sort_unstable();
        self.model == network.parts().name || !own.is_empty() && own == inputs
    }

    /// Whether this is the target of the job, by its name and unchanged.
    pub fn is_on(&self, target: &Target) -> bool {
        self.target == target.name() && !target.is_changed()
    }
}

/// Returns the shipped scenario of a model, if any; a path names no shipped model.
///
/// # Errors
/// As [`scenario`].
pub fn shipped_for(model: &str) -> Result<Option<ScenarioFile>> {
    if shipped::is_path(model) {
        return Ok(None);
    }
    let scenarios = shipped::SCENARIOS.iter().map(|shipped| scenario(&shipped.source())).collect::<Result<Vec<_>, _>>();
    Ok(scenarios?.into_iter().find(|scenario| scenario.model == model))
}

/// Returns the shipped scenario that `paper` names for a model: its own, else the first that serves
/// other networks.
///
/// # Errors
/// As [`scenario`].
pub fn paper_for(model: &str) -> Result<Option<ScenarioFile>> {
    let own = shipped_for(model)?;
    let mut all = shipped::SCENARIOS.iter().map(|shipped| scenario(&shipped.source()));
    let other = || all.find(|file| file.as_ref().map_or(true, |file| !file.inputs.is_empty())).transpose();
    own.map_or_else(other, |own| Ok(Some(own)))
}

/// Parses and checks a scenario.
///
/// # Errors
/// A diagnostic where the file is malformed, a number is 0, there are more chips than cores, or a
/// table of measurements does not ship.
pub fn scenario(source: &SourceText) -> Result<ScenarioFile> {
    let file: ScenarioFile = parse(source, "scenario.syntax")?;
    if file.copies.value == 0 {
        return Err(Diagnostic::new("scenario.number", "a scenario has at least one copy").at(source, file.copies.span));
    }
    let cores = &file.deployment.value;
    let some = [cores.cores_used, cores.chips_used].iter().all(|&number| number > 0);
    if !some || cores.chips_used > cores.cores_used || file.compartments_per_core == Some(0) {
        let message = "a deployment has cores and chips, and no more chips than cores";
        return Err(Diagnostic::new("scenario.number", message).at(source, file.deployment.span));
    }
    for table in &file.measured {
        if shipped::Shipped::find(shipped::MEASUREMENTS, &table.value).is_none() {
            let unknown = shipped::unknown("scenario.measured", "table of measurements", table, shipped::MEASUREMENTS);
            return Err(unknown.at(source, table.span));
        }
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::measurement::load_measurements;
    use nsim_files::target::load_target;
    use nsim_import::model::load_model;
    use nsim_ir::graph::PopulationKind;

    #[test]
    fn shipped_scenarios_name_what_ships_and_agree_with_their_tables() {
        for shipped in shipped::SCENARIOS {
            let file = scenario(&shipped.source()).unwrap();
            let model = load_model(&file.model).unwrap();
            assert_eq!(model.file().name, file.model);
            let graph = nsim_files::lower::lower(&model).unwrap();
            let inputs = graph.populations().filter(|(_, one)| matches!(one.kind, PopulationKind::Input));
            let mut inputs: Vec<u32> = inputs.map(|(_, one)| one.shape.len()).collect();
            inputs.sort_unstable();
            assert_eq!(inputs, file.inputs);
            assert!(u64::from(load_target(&file.target).unwrap().cores()) >= file.deployment.value.cores_used);
            for table in &file.measured {
                let table = load_measurements(table).unwrap();
                let job = (&table.model, &table.target, table.copies);
                assert_eq!(job, (&file.model, &file.target, file.copies.value));
            }
        }
    }

    #[test]
    fn only_shipped_models_have_a_shipped_scenario() {
        assert_eq!(shipped_for("vtsnn-slip").unwrap().unwrap().copies.value, 32);
        assert!(shipped_for("slip-tactile").unwrap().is_none());
        assert!(shipped_for("models/vtsnn-slip.ron").unwrap().is_none());
        // Its job is that of `paper` for others, too.
        assert_eq!(paper_for("models/vtsnn-slip.ron").unwrap().unwrap().model, "vtsnn-slip");
    }

    #[test]
    fn impossible_numbers_are_refused_where_they_stand() {
        let text = shipped::SCENARIOS[0].text;
        for (from, to, code) in [
            ("copies: 32", "copies: 0", "scenario.number"),
            ("chips_used: 5", "chips_used: 595", "scenario.number"),
            ("cores_used: 594", "cores_used: 0", "scenario.number"),
            ("\"vtsnn-offline\"", "\"vtsnn\"", "scenario.measured"),
            ("input_relays: true", "input_relays: yes", "scenario.syntax"),
        ] {
            let problem = scenario(&SourceText::new("s.ron", text.replacen(from, to, 1))).unwrap_err();
            assert_eq!(problem.code, code, "{problem}");
            assert!(problem.position().is_some(), "{problem}");
        }
    }
}
