//! A model with every array in place.

use std::collections::BTreeMap;

use super::learning::RuleDesc;
use super::{Network, NetworkFile, Parameter, ProjectionDesc, ProjectionKind, Weights, tensor};
use crate::synapses::SynapsePlace;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::locate::items;

fn seeded(what: &str) -> Diagnostic {
    Diagnostic::new("export.unsupported", format!("{what} cannot be exported"))
        .help("other tools do not support seeded numbers: give them as an array")
}

fn one_rule(projection: &ProjectionDesc) -> Diagnostic {
    let name = projection.name_or_ends();
    let message = format!("projection '{name}' has a rule and several delays, which a list of synapses has not");
    Diagnostic::new("export.unsupported", message).help("copy the model and its array files")
}

impl Network {
    /// The model with every array in place; synapse arrays become a `Sparse` projection per delay.
    ///
    /// # Errors
    /// `export.unsupported` for seeded arrays.
    pub fn resolved(&self) -> Result<NetworkFile> {
        let mut model = self.file().clone();
        for population in &mut model.populations {
            for (_, parameter) in population.loihi.iter_mut().flatten() {
                if let Parameter::From(source) = parameter {
                    let array = source.array().ok_or_else(|| seeded("a Uniform array"))?;
                    *parameter = Parameter::Each(self.array(&array).reals().collect());
                }
            }
        }
        let sizes: BTreeMap<&str, u64> = model.populations.iter().map(|p| (p.name.as_str(), p.units())).collect();
        let declared = items(self.source().text(), "projections");
        let mut projections = Vec::new();
        for (index, mut projection) in std::mem::take(&mut model.projections).into_iter().enumerate() {
            for (_, weights) in projection.learning.iter_mut().flat_map(RuleDesc::arrays_mut) {
                *weights = self.in_place(weights)?;
            }
            match &mut projection.kind {
                ProjectionKind::Dense(weights) | ProjectionKind::Conv2d { weights, .. } => {
                    *weights = self.in_place(weights)?;
                }
                ProjectionKind::Sparse(_) | ProjectionKind::SumPool2d { .. } => {}
                ProjectionKind::Random { .. } => return Err(seeded("a Random projection")),
                ProjectionKind::Arrays(arrays) => {
                    let place = SynapsePlace {
                        text: self.source(),
                        declared: declared.get(index).copied().unwrap_or_default(),
                        sources: projection.from.iter().filter_map(|name| sizes.get(name.as_str())).sum(),
                        targets: sizes.get(projection.to.as_str()).copied().unwrap_or(0),
                    };
                    let by_delay = arrays.read(|array| self.array(array), &place)?;
                    if projection.learning.is_some() && by_delay.len() > 1 {
                        return Err(one_rule(&projection));
                    }
                    for (delay, listed) in by_delay {
                        let wide = listed.into_iter().map(|(from, to, weight, _)| (from.into(), to.into(), weight));
                        projections.push(ProjectionDesc {
                            kind: ProjectionKind::Sparse(wide.collect()),
                            delay: delay.unwrap_or(projection.delay),
                            ..projection.clone()
                        });
                    }
                    continue;
                }
            }
            projections.push(projection);
        }
        model.projections = projections;
        Ok(model)
    }

    fn in_place(&self, weights: &Weights) -> Result<Weights> {
        let stored = self.tensor(weights).ok_or_else(|| seeded("a Uniform array"))?;
        Ok(tensor(stored.shape().to_vec(), stored.reals().collect()))
    }
}
