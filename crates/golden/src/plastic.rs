//! State of the synapses of plastic projections, by delivery.

use nsim_ir::base::id::{PopulationId, RuleId};
use nsim_ir::learning::Variable;
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Projection, Quantised};

use crate::synapses::connections_by_source;

/// One value of each synapse, source by source, for each [`Variable`].
#[derive(Debug, Clone)]
pub(crate) struct Columns(pub [Vec<i16>; 3]);

impl Columns {
    pub(crate) fn column(&self, variable: Variable) -> &[i16] {
        &self.0[variable as usize]
    }
}

/// The synapses of a plastic projection.
#[derive(Debug, Clone)]
pub(crate) struct Plastic {
    pub format: SynapseFormat,
    /// Its rule and target population, which is another one in each copy of the network.
    pub learner: (RuleId, PopulationId),
    /// Row of each synapse among those of the rule.
    pub rows: Vec<u32>,
    /// Of each synapse, the index of its source and target among those of the rule.
    pub ends: Vec<(u32, u32)>,
    /// Whether its rule changes delays that act.
    pub moves: bool,
    /// The values before it learned.
    first: Columns,
    /// All values since the sample began, each with the delivery from which they hold. Delivery s
    /// is that of the inputs of step s and of the spikes of step s - 1.
    written: Vec<(u32, Columns)>,
}

impl Plastic {
    /// The state of a projection with a rule.
    pub(crate) fn new(network: &Quantised, projection: &Projection) -> Plastic {
        let plastic = projection.plastic.as_ref().expect("the projection is plastic");
        let rule = &network.parts().rules[plastic.rule].rule;
        let synapses = connections_by_source(network, projection);
        let acts = rule.semantics().delays_act();
        let field = i16::from(projection.delay.get());
        let numbers = 0..synapses.len();
        let first = Columns([
            synapses.iter().map(|&(.., weight)| weight as i16).collect(),
            numbers.clone().map(|number| if acts { field } else { plastic.delay(number) }).collect(),
            numbers.map(|number| plastic.tag(number)).collect(),
        ]);
        Plastic {
            format: projection.format,
            learner: (plastic.rule, projection.target),
            rows: plastic.rows.to_vec(),
            ends: synapses.iter().map(|&(from, to, _)| (plastic.first_source + from, to)).collect(),
            moves: acts && rule.changes(Variable::Delay),
            written: vec![(0, first.clone())],
            first,
        }
    }

    /// The values of a delivery.
    pub(crate) fn at(&self, delivery: u32) -> &Columns {
        let (_, columns) = self.written.iter().rev().find(|(from, _)| *from <= delivery).expect("some hold from 0");
        columns
    }

    /// The latest values.
    pub(crate) fn latest(&self) -> &Columns {
        let (_, columns) = self.written.last().expect("some hold from 0");
        columns
    }

    /// Sets the values from a delivery on.
    pub(crate) fn write(&mut self, from: u32, columns: Columns) {
        self.written.push((from, columns));
    }

    /// Begins another sample, which keeps the latest values.
    pub(crate) fn begin(&mut self) {
        self.written = vec![(0, self.latest().clone())];
    }

    /// Restores the first values.
    pub(crate) fn forget(&mut self) {
        self.written = vec![(0, self.first.clone())];
    }
}
