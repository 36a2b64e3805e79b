//! Learning rules of a model: their text becomes a checked rule, their first values integers.

use std::collections::HashSet;

use petgraph::graph::{DiGraph, NodeIndex};

use super::{Lowering, MOST_UNIFORM, Nodes, ProjectionLowering, is_no_name};
use crate::network::learning::{PerSynapse, PostTrace, RewardDesc, RuleDesc};
use crate::network::{ProjectionKind as Kind, Weights};
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::diagnostic::{Diagnostic, Span};
use nsim_ir::graph::{DeclaredRule, PerCompartment, Population, PopulationKind, Projection};
use nsim_ir::learning::{Graded, Learning, LearningSemantics, Rule, RuleText, TraceSettings, Variable, parse};
use nsim_ir::spikes::Message;

type Result<T> = std::result::Result<T, Diagnostic>;

/// The code of every error of a rule.
const CODE: &str = "model.learning";

impl Lowering<'_> {
    /// Checks the names of projections: those that are given, and those of rules.
    pub(super) fn check_names(&self, spans: &[Span]) -> Result<()> {
        let mut names = HashSet::new();
        for (index, projection) in self.network.file().projections.iter().enumerate() {
            let span = spans.get(index).copied().unwrap_or_default();
            if let Some(name) = projection.name.as_deref().filter(|name| is_no_name(name) || name.contains('>')) {
                let help = "use letters, digits, '_' and '-'";
                let message = format!("'{name}' cannot be a projection's name");
                return Err(self.error("model.name", message, self.at(span, "name")).help(help));
            }
            let named = projection.name.is_some() || projection.learning.is_some();
            if named && !names.insert(projection.name_or_ends()) {
                let message = format!("projection '{}' is declared twice", projection.name_or_ends());
                let help = "give each projection with a rule its own name: name: \"..\"";
                return Err(self.error("model.name-twice", message, self.at(span, "name")).help(help));
            }
        }
        Ok(())
    }

    /// The arithmetic of learning.
    fn learning_semantics(&self) -> LearningSemantics {
        let file = self.network.file();
        file.learning_semantics.unwrap_or(match file.semantics {
            Semantics::Lava => LearningSemantics::Lava,
            _ => LearningSemantics::Silicon,
        })
    }
}

impl ProjectionLowering<'_> {
    /// The rule of the projection.
    pub(super) fn rule(
        &self,
        sources: &[NodeIndex],
        target: NodeIndex,
        nodes: &Nodes,
        graph: &DiGraph<Population, Projection>,
    ) -> Result<Option<DeclaredRule>> {
        let Some(desc) = &self.desc.learning else { return Ok(None) };
        self.check_ends(sources, target, graph)?;
        if desc.graded != Graded::Regular
            && let Some(source) = sources.iter().map(|&node| &graph[node]).find(|s| s.message == Message::Spike)
        {
            let what = format!("{:?} reads payloads, but '{}' sends plain spikes", desc.graded, source.name);
            return Err(self
                .refused("graded", what)
                .help("give graded: Regular, or the source a payload or message_bits"));
        }
        let rule = self.checked(desc)?;
        let (semantics, units) = (rule.semantics(), self.target_shape.len());
        if desc.delays.is_some() && semantics.delays_act() {
            let what = "delays are those of the synapses, which act";
            return Err(self.refused("delays", what).help("give the projection's delay: or the arrays' delay:"));
        }
        let mut signals = [None; 3];
        for (signal, (field, trace)) in signals.iter_mut().zip(desc.post_traces()) {
            let Some(PostTrace::Signal(name)) = trace else { continue };
            if semantics == LearningSemantics::Brian {
                let help = "give the impulse and tau of a trace, or learning_semantics: Silicon";
                return Err(self.refused(field, "learning semantics Brian lack signals").help(help));
            }
            let (path, file) = (format!("learning.{field}"), self.lowering.network.file());
            let node = self.lowering.find(nodes, name, field, || self.at(&path))?;
            if !file.population(name).is_some_and(|population| population.signal) {
                let help = format!("declare it so: Signal(name: \"{name}\", shape: [1])");
                return Err(self.refused(field, format!("'{name}' is not a Signal population")).help(help));
            }
            let size = graph[node].shape.len();
            if desc.is_pes && 2 * u64::from(size) != u64::from(units) {
                let what = format!("'{name}' has {size} values for {units} targets, which are not two for each value");
                let help = "the first half of the targets learns from the negative error, the second half from it";
                return Err(self.refused(field, what).help(help));
            }
            if !desc.is_pes && ![1, units].contains(&size) {
                let what = format!("'{name}' has {size} values for {units} targets");
                return Err(self.refused(field, what).help(format!("give it the shape [1] or [{units}]")));
            }
            *signal = Some(node);
        }
        let reward =
            desc.r1.as_ref().map(|r1| self.lowering.find(nodes, &r1.from, "r1", || self.at("learning.r1.from")));
        Ok(Some(DeclaredRule {
            tags: self.first_values("tags", desc.tags.as_ref(), semantics.tags())?,
            delays: self.first_values("delays", desc.delays.as_ref(), semantics.delays())?,
            learning: Learning { name: self.desc.name_or_ends(), rule },
            span: self.at("learning"),
            sources: self.source_units as u32,
            signals,
            reward: reward.transpose()?,
        }))
    }

    /// Refuses kinds and ends that have no synapses of their own.
    fn check_ends(
        &self,
        sources: &[NodeIndex],
        target: NodeIndex,
        graph: &DiGraph<Population, Projection>,
    ) -> Result<()> {
        if let Kind::Conv2d { .. } | Kind::SumPool2d { .. } = &self.desc.kind {
            let what = format!("the synapses of a {} share their weights, so they cannot learn", self.desc.kind_name());
            return Err(self.refused("", what).help("list the synapses: Sparse(..)"));
        }
        for &node in sources.iter().chain([&target]) {
            if matches!(graph[node].kind, PopulationKind::Srm(_)) {
                let what = format!("'{}' has spike response neurons, which do not learn", graph[node].name);
                return Err(self.refused("", what).help("remove learning, or declare Loihi neurons"));
            }
        }
        // PES draws for each pair of a source and a target.
        let is_pes = self.desc.learning.as_ref().is_some_and(|rule| rule.is_pes);
        let pairs = || vec![self.source_units, u64::from(self.target_shape.len())];
        let counted = if is_pes { pairs() } else { self.shape_of_rows() };
        let synapses = counted.into_iter().fold(1, u64::saturating_mul);
        if synapses > MOST_UNIFORM {
            let what = format!("{synapses} synapses that learn are more than {MOST_UNIFORM}");
            return Err(self.refused("", what).help("divide the populations, or remove learning"));
        }
        let twice = (1..sources.len()).find(|&index| sources[..index].contains(&sources[index]));
        if let Some(index) = twice {
            let what = format!("'{}' is a source twice", self.desc.from[index]);
            let span = self.at(&format!("from.[{index}]"));
            return Err(self
                .refused("", what)
                .help("declare two projections")
                .at(self.lowering.network.source(), span));
        }
        Ok(())
    }

    /// The rule, with its changes parsed.
    fn checked(&self, desc: &RuleDesc) -> Result<Rule> {
        let mut text = RuleText { graded: desc.graded, until: desc.until, ..RuleText::default() };
        text.semantics = self.lowering.learning_semantics();
        match (desc.is_pes, text.semantics == LearningSemantics::Nengo) {
            (true, true) => return Ok(Rule::pes(desc.x1.unwrap_or_default(), desc.until)),
            (true, false) => {
                let what = format!("Pes is a rule of Nengo, the network's learning semantics are {:?}", text.semantics);
                return Err(self.refused("", what).help("give the network learning_semantics: Nengo"));
            }
            (false, true) => {
                let help = "write Pes(error: \"..\", x1: (impulse: 16, tau: 5)), or learning_semantics: Silicon";
                return Err(self.refused("", "of all rules, learning semantics Nengo have Pes alone").help(help));
            }
            (false, false) => {}
        }
        for variable in Variable::ALL {
            let (field, change) = desc.change(variable);
            if !change.is_empty() {
                let wrong = |problem: nsim_ir::learning::Problem| {
                    let span = self.within(field, change, problem.at);
                    self.lowering.error(CODE, self.sentence(format!("{field}: {}", problem.message)), span)
                };
                text.changes[variable as usize] = parse(change).map_err(wrong)?;
            }
        }
        let epoch = desc.epoch.unwrap_or(1);
        text.epoch = u8::try_from(epoch).unwrap_or(0);
        let post = desc.post_traces().map(|(_, trace)| match trace {
            Some(PostTrace::Spikes(settings)) => *settings,
            _ => Default::default(),
        });
        let [y1, y2, y3] = post;
        let r1 = desc.r1.as_ref().map(|&RewardDesc { impulse, tau, .. }| TraceSettings { impulse, tau });
        text.traces = [desc.x1.unwrap_or_default(), desc.x2.unwrap_or_default(), y1, y2, y3, r1.unwrap_or_default()];
        let rule =
            Rule::new(text).map_err(|problem| self.refused(problem.field, problem.message).help(problem.help))?;
        match rule.learns() {
            true => Ok(rule),
            false => {
                Err(self.refused("", "the rule changes nothing").help("give dw, dd or dt, such as dw: \"2^-2*x1*y0\""))
            }
        }
    }

    /// The place of a byte of a change's text; of the whole text where it has escapes.
    fn within(&self, field: &str, change: &str, at: usize) -> Span {
        let whole = self.at(&format!("learning.{field}"));
        let source = self.lowering.network.source().text();
        if source.get(whole.start + 1..whole.end.saturating_sub(1)) != Some(change) {
            return whole;
        }
        let length = change.get(at..).unwrap_or_default().chars().next().map_or(1, char::len_utf8);
        Span { start: whole.start + 1 + at, end: whole.start + 1 + at + length }
    }

    /// First tags or delays by row, within these bounds.
    fn first_values(
        &self,
        field: &'static str,
        values: Option<&PerSynapse>,
        (low, high): (i32, i32),
    ) -> Result<PerCompartment<i16>> {
        let path = format!("learning.{field}");
        let given = match values {
            None => PerCompartment::Same(0.0),
            Some(PerSynapse::Same(value)) => PerCompartment::Same(*value),
            Some(PerSynapse::Each(values)) => {
                let shape = self.shape_of_rows();
                let tensor = match values {
                    Weights::InPlace(tensor) => std::sync::Arc::new(tensor.clone()),
                    Weights::From(source) => self.lowering.source_tensor(source, &shape, self.at(&path))?,
                };
                if !tensor.shape().iter().map(|&axis| axis as u64).eq(shape.iter().copied()) {
                    let what = format!("{field} are {:?}, the synapses are {shape:?}", tensor.shape());
                    return Err(self
                        .refused(field, what)
                        .help("Dense takes [target][source], others one for each synapse"));
                }
                PerCompartment::Each(tensor.reals().collect())
            }
        };
        given.try_map(|row, value| {
            let fits = value.fract() == 0.0 && (f64::from(low)..=f64::from(high)).contains(&value);
            fits.then_some(value as i16).ok_or_else(|| {
                let of = row.map_or(String::new(), |row| format!(" of synapse {row}"));
                let what = format!("{field}: the value {value}{of} is not a whole number from {low} to {high}");
                self.refused(field, what).help("give whole numbers within the range")
            })
        })
    }

    /// The shape of a number for each synapse.
    fn shape_of_rows(&self) -> Vec<u64> {
        match &self.desc.kind {
            Kind::Sparse(synapses) => vec![synapses.len() as u64],
            Kind::Arrays(arrays) => vec![self.lowering.network.array(&arrays.target).len() as u64],
            Kind::Random { fan_out, .. } => vec![fan_out.saturating_mul(self.source_units)],
            _ => vec![u64::from(self.target_shape.len()), self.source_units],
        }
    }

    fn sentence(&self, what: impl std::fmt::Display) -> String {
        format!("projection '{}': {what}", self.desc.name_or_ends())
    }

    /// An error of the rule, at one of its fields or at all of it.
    fn refused(&self, field: &str, what: impl std::fmt::Display) -> Diagnostic {
        let path = format!("learning.{field}");
        self.error(CODE, self.sentence(what), path.trim_end_matches('.'))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use crate::lower::lower;
    use crate::network::{Network, NetworkFile};
    use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
    use nsim_ir::graph::Graph;
    use nsim_ir::tensor::ArrayRef;

    const HEAD: &str = "Network(name: \"t\", timestep_ms: 1.0, semantics: Lava, populations: [\
        Input(name: \"in\", shape: [2]), Signal(name: \"reward\", shape: [3]), \
        Loihi(name: \"o\", shape: [3], du: 4096, dv: 4096, vth_mant: 1)], output: \"o\", projections: [";

    fn parsed(text: &str) -> Result<NetworkFile, Diagnostic> {
        NetworkFile::parse(&SourceText::new("t.ron", text))
    }

    fn lowered(text: &str) -> Result<Graph, Diagnostic> {
        lower(&parsed(text)?.build_changed(Path::new("t.ron"), |_| Ok(SourceText::new("t.ron", text)))?)
    }

    #[test]
    fn a_written_rule_reads_back() {
        let text = format!(
            "{HEAD}Sparse(name: \"p\", from: [\"in\"], to: \"o\", synapses: [(0, 1, 2), (1, 2, 4)], learning: Rule(\
             dw: \"2^-2*x1*y0\", dt: \"u3\", epoch: 7, x1: (impulse: 16.5, tau: 10), y1: (impulse: 1, tau: 2), \
             y2: Signal(\"reward\"), tags: [1, -2], delays: 3, until: 90)), \
             Dense(from: [\"in\"], to: \"o\", weights: [[2, 4], [6, 8], [0, 2]], learning: Rule(dd: \"x0\", \
             delays: [[1, 2], [3, 4], [5, 6]]))], learning_semantics: Lava)"
        );
        let model = parsed(&text).unwrap();
        let (written, tensors) = model.ron("a").unwrap();
        let arrays = tensors.into_iter().map(|(key, tensor)| (ArrayRef::Safetensors("a".into(), key), tensor));
        let again =
            Network::new(parsed(&written).unwrap(), SourceText::new("a.ron", written.as_str()), arrays.collect());
        let first = model.build(Path::new("t.ron")).unwrap().resolved().unwrap();
        assert_eq!(again.unwrap().resolved().unwrap(), first, "{written}");
        let graph = lowered(&text).unwrap();
        let names: Vec<&str> = graph.facts().rules.iter().map(|rule| rule.learning.name.as_str()).collect();
        assert_eq!(names, ["p", "in->o"]);
        assert_eq!(graph.facts().rules.as_slice()[1].delays.values(), [1, 2, 3, 4, 5, 6]);
    }

    fn with_change(change: &str) -> String {
        format!(
            "{HEAD}Random(from: [\"in\"], to: \"o\", fan_out: 1, low: 2, high: 2, seed: 1, learning: Rule(dw: {change}))])"
        )
    }

    #[test]
    fn a_wrong_byte_of_a_rule_is_shown() {
        let text = with_change("\"x0*x1 - z*x0\"");
        let problem = lowered(&text).unwrap_err();
        assert_eq!(problem.position().unwrap().column, text.find("z*x0").unwrap() + 1, "{problem}");
    }

    proptest! {
        #[test]
        fn no_text_of_a_rule_panics(change in "\\PC*", part in "[x0-9yudwt()*+^ -]{0,40}") {
            for text in [change, part] {
                let _ = lowered(&with_change(&format!("{text:?}")));
                let _ = parsed(&with_change(&text));
            }
        }
    }
}
