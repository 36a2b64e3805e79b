//! The result of `nsim agree` as text, JSON, CSV and SVG.

use serde_json::{Value, json};

use crate::charts::draw::Axis;
use crate::charts::plot::{self, Series};
use crate::charts::results;
use crate::origin;
use nsim_agree::attribution::{Attribution, LayerLoss, Share};
use nsim_agree::causes::Cause;
use nsim_agree::classes::ClassTally;
use nsim_agree::compare::{Agreement, LayerRow};
use nsim_files::table::{
    Column, count, csv, four, markdown_of, or_empty, rounded, shell_lines, table_of, three, wrapped,
};
use nsim_ir::graph::Graph;
use nsim_quantise::analytic::Fit;
use nsim_train::convert::next::Suggestion;
use nsim_train::convert::search::{ConversionScore, SearchResult};
use nsim_train::convert::staged::is_real;

/// Data of the report.
#[derive(Debug, Default)]
pub struct AgreeReport<'a> {
    /// The network's name.
    pub model: &'a str,
    /// Its role, where the name alone is ambiguous.
    pub role: &'static str,
    /// Name and role of the other, deployed network, where two are compared.
    pub other: Option<(&'a str, &'static str)>,
    /// Counterpart of the deployed network.
    pub against: &'static str,
    /// Sources of the samples.
    pub input: &'a [String],
    /// Their seed, when they had one.
    pub seed: Option<u64>,
    /// Number of samples.
    pub samples: usize,
    /// Classes of the two; none when the output is not compared.
    pub classes: Option<ClassTally>,
    /// Share of right classes of the two, when samples have labels.
    pub accuracy: Option<(f64, f64)>,
    /// Row of each layer.
    pub layers: &'a [LayerRow],
    /// The search, when there was one.
    pub found: Option<&'a SearchResult>,
    /// The converted form of each spike response population.
    pub fits: &'a [(String, Fit)],
    /// Causes, if requested.
    pub attribution: Option<&'a Attribution>,
    /// Number of samples of the attribution.
    pub attribution_samples: usize,
    /// The suggested next command.
    pub next: Option<&'a Suggestion>,
    /// The target of the deployed network.
    pub target: Option<&'a str>,
    /// Source of a converted model, and the command that compares with it.
    pub source: Option<(&'a str, String)>,
    /// Pictures that were written.
    pub files: &'a [String],
}

/// Source of a model that `nsim convert` wrote.
pub fn converted_from(graph: &Graph) -> Option<&str> {
    let (source, _) = graph.facts().provenance.as_deref()?.strip_prefix("nsim convert ")?.split_once(';')?;
    Some(source)
}

/// Role of a network: trained, converted, or empty for neither.
pub fn role(graph: &Graph) -> &'static str {
    match converted_from(graph) {
        Some(_) => "the converted network",
        None if is_real(graph) => "the trained network",
        None => "",
    }
}

/// Name of a network, with its role.
fn name_with_role((name, role): (&str, &str)) -> String {
    if role.is_empty() { name.to_string() } else { format!("{name}, {role}") }
}

/// Counterpart of a network, in words.
fn counterpart_text(against: &str) -> &str {
    match against {
        "srm" => "the trained network, spike response neurons",
        "cuba" => "the trained network, real numbers",
        "golden" => "the same integers, interpreted",
        other => other,
    }
}

impl<'a> AgreeReport<'a> {
    /// Report on two networks, without a search and causes.
    pub fn for_two_networks(
        [(model, role), other]: [(&'a str, &'static str); 2],
        (input, seed, samples): (&'a [String], Option<u64>, usize),
        agreement: &'a Agreement,
    ) -> Self {
        AgreeReport {
            model,
            role,
            other: Some(other),
            against: "another model",
            input,
            seed,
            samples,
            classes: agreement.classes,
            accuracy: agreement.accuracy,
            layers: &agreement.layers,
            ..AgreeReport::default()
        }
    }

    /// Report on a network and its counterpart, before a search and causes are added.
    pub fn for_counterpart(
        (model, against): (&'a str, &'static str),
        input: (&'a [String], Option<u64>, usize),
        agreement: &'a Agreement,
    ) -> Self {
        AgreeReport { other: None, against, ..Self::for_two_networks([(model, ""); 2], input, agreement) }
    }
}

/// The converted form of each spike response population, by its name.
pub fn named_fits(graph: &Graph, fits: &[Option<Fit>]) -> Vec<(String, Fit)> {
    let each = graph.populations().zip(fits);
    each.filter_map(|((_, population), fit)| Some((population.name.clone(), fit.clone()?))).collect()
}

/// `nsim.agree/1` of a network that could not be deployed.
pub fn empty_result() -> Value {
    json!({
        "schema": "nsim.agree/1", "model": null, "target": null, "fits": false, "reasons": [], "samples": 0,
        "compared": 0, "class_agreement": null, "layers": [], "conversion": null, "attribution": [],
    })
}

/// Text on the agreement of classes, with the number of samples that are not compared.
pub(super) fn classes_text(classes: &ClassTally) -> String {
    let undecided = classes.undecided();
    let rest = if undecided.is_empty() { String::new() } else { format!("; not compared: {undecided}") };
    match classes.agreement() {
        Some(share) => {
            let compared = count(classes.compared as u64, "sample");
            format!("classes agree in {} of {compared} ({}){rest}", classes.same, three(share))
        }
        None => format!("no sample is decided by both networks, so no class is compared{rest}"),
    }
}

/// Whether neither network spikes in a layer: equal trains of no spikes are nothing to compare.
pub(super) fn is_silent(row: &LayerRow) -> bool {
    row.comparison.tally.spikes_a + row.comparison.tally.spikes_b == 0
}

/// JSON of a layer, as in the list `layers`.
pub(super) fn layer_json(row: &LayerRow) -> Value {
    let tally = &row.comparison.tally;
    let divergence = row.comparison.first_divergence.map(|d| {
        json!({
            "sample": d.sample, "timestep": d.timestep, "neuron": d.neuron, "a": u8::from(d.a), "b": u8::from(d.b),
            "potential_a": d.potential_a.map(rounded), "potential_b": d.potential_b.map(rounded),
        })
    });
    json!({
        "name": row.name, "shift": row.shift, "spikes_a": tally.spikes_a, "spikes_b": tally.spikes_b,
        "coincidence": (!is_silent(row)).then(|| rounded(tally.coincidence())),
        "van_rossum": rounded(tally.van_rossum()), "victor_purpura": rounded(tally.victor_purpura()),
        "potential_rmse": tally.potential_rmse().map(rounded), "count_error": rounded(tally.count_error()),
        "first_divergence": divergence,
    })
}

const FIT_COLUMNS: [Column<(String, Fit)>; 6] = [
    ("population", |(name, _)| name.clone()),
    ("du", |(_, fit)| fit.du.to_string()),
    ("dv", |(_, fit)| fit.dv.to_string()),
    ("refractory", |(_, fit)| fit.refractory.to_string()),
    ("threshold", |(_, fit)| four(fit.threshold)),
    ("delayed copies", |(_, fit)| fit.taps.len().to_string()),
];

fn score_columns<'a>() -> [Column<(&'a str, &'a ConversionScore)>; 4] {
    [
        ("search", |(name, _)| (*name).to_string()),
        ("classes agree", |(_, score)| four(score.classes.share_reproduced())),
        ("coincidence", |(_, score)| four(score.coincidence)),
        ("output counts off by", |(_, score)| format!("{:.2} %", 100.0 * score.count_error)),
    ]
}

/// Scores of the analytic start of a search and of its end.
fn scores(found: &SearchResult) -> [(&str, &ConversionScore); 2] {
    [("analytic start", &found.start), ("end of the search", &found.end)]
}

fn score_json(score: &ConversionScore) -> Value {
    json!({
        "class_agreement": score.classes.agreement().map(rounded), "coincidence": rounded(score.coincidence),
        "count_error": rounded(score.count_error),
    })
}

const LAYER_COLUMNS: [Column<LayerRow>; 8] = [
    ("layer", |row| row.name.clone()),
    ("shift", |row| row.shift.to_string()),
    ("spikes a", |row| row.comparison.tally.spikes_a.to_string()),
    ("spikes b", |row| row.comparison.tally.spikes_b.to_string()),
    ("coincidence", |row| if is_silent(row) { "silent".to_string() } else { four(row.comparison.tally.coincidence()) }),
    ("van Rossum", |row| four(row.comparison.tally.van_rossum())),
    ("Victor-Purpura", |row| four(row.comparison.tally.victor_purpura())),
    ("potential rmse", |row| or_empty(row.comparison.tally.potential_rmse().map(four))),
];

/// Columns of the text after the first four of all, with the first difference of a layer.
const TEXT_COLUMNS: [Column<LayerRow>; 3] = [
    ("coincidence", |row| if is_silent(row) { "-".to_string() } else { three(row.comparison.tally.coincidence()) }),
    ("potential rmse", |row| or_empty(row.comparison.tally.potential_rmse().map(three))),
    ("first parts at sample/step/neuron, who spikes", |row| match row.comparison.first_divergence {
        _ if is_silent(row) => "silent".to_string(),
        None => "nowhere".to_string(),
        Some(d) => format!("{}/{}/{} {}", d.sample, d.timestep, d.neuron, if d.a { "a" } else { "b" }),
    }),
];

/// Columns of the causes.
const SHARE_COLUMNS: [Column<Share>; 8] = [
    ("cause", |share| share.cause.name().to_string()),
    ("share", |share| or_empty(share.share.map(|share| format!("{:.1} %", 100.0 * share)))),
    ("forward", |share| four(share.forward)),
    ("reversed", |share| four(share.reversed)),
    ("without", |share| four(share.without.coincidence)),
    ("classes agree", |share| or_empty(share.stage.class_agreement.map(four))),
    ("coincidence", |share| four(share.stage.coincidence)),
    ("potential rmse", |share| or_empty(share.stage.potential_rmse.map(four))),
];

/// Columns of the causes in the text.
const SHARE_TEXT: [Column<Share>; 6] =
    [SHARE_COLUMNS[0], SHARE_COLUMNS[1], SHARE_COLUMNS[4], SHARE_COLUMNS[5], SHARE_COLUMNS[6], SHARE_COLUMNS[7]];

impl AgreeReport<'_> {
    /// Share of samples with the same class, of those that both decide.
    pub fn class_agreement(&self) -> Option<f64> {
        self.classes.and_then(|classes| classes.agreement())
    }

    fn share_json(share: &Share) -> Value {
        json!({
            "cause": share.cause.name(), "class_agreement": share.stage.class_agreement.map(rounded),
            "coincidence": rounded(share.stage.coincidence), "potential_rmse": share.stage.potential_rmse.map(rounded),
            "share": share.share.map(rounded), "forward": rounded(share.forward), "reversed": rounded(share.reversed),
            "interaction": rounded(share.interaction()),
            "without": {
                "class_agreement": share.without.class_agreement.map(rounded),
                "coincidence": rounded(share.without.coincidence),
            },
        })
    }

    fn conversion_json(&self) -> Value {
        if self.fits.is_empty() {
            return Value::Null;
        }
        let populations = self.fits.iter().map(|(name, fit)| {
            json!({
                "name": name, "du": fit.du.get(), "dv": fit.dv.get(), "refractory": fit.refractory.get(),
                "threshold": rounded(fit.threshold), "delays": fit.taps.iter().map(|copy| copy.0).collect::<Vec<_>>(),
                "factors": fit.taps.iter().map(|copy| rounded(copy.1)).collect::<Vec<_>>(),
            })
        });
        let search = self.found.map(|found| {
            json!({
                "start": score_json(&found.start), "residual": score_json(&found.end),
                "tried": found.tried, "samples": found.samples,
            })
        });
        json!({ "populations": populations.collect::<Vec<_>>(), "search": search })
    }

    /// `nsim.agree/1`.
    pub fn json(&self) -> Value {
        json!({
            "schema": "nsim.agree/1", "model": self.model, "against": self.against, "input": self.input,
            "seed": self.seed, "samples": self.samples, "compared": self.classes.map(|classes| classes.compared),
            "class_agreement": self.class_agreement().map(rounded),
            "accuracy_a": self.accuracy.map(|(a, _)| rounded(a)), "accuracy_b": self.accuracy.map(|(_, b)| rounded(b)),
            "layers": self.layers.iter().map(layer_json).collect::<Vec<_>>(), "conversion": self.conversion_json(),
            "disagreement": self.attribution.map(|attribution| rounded(attribution.disagreement)),
            "lost": self.attribution.map_or(&[][..], |a| &a.layers).iter().map(lost_json).collect::<Vec<_>>(),
            "attribution_samples": self.attribution.map(|_| self.attribution_samples),
            "attribution": self.attribution.map_or(&[][..], |a| &a.shares).iter().map(Self::share_json).collect::<Vec<_>>(),
            "next": self.next.map(next_json), "target": self.target,
            "converted_from": self.source.as_ref().map(|(trained, _)| trained),
        })
    }

    /// Message where accuracy falls by a twentieth of the samples or more.
    pub fn falls(&self) -> Option<String> {
        let (a, b) = self.accuracy.filter(|(a, b)| a - b >= 0.05)?;
        Some(format!("accuracy falls from {} to {} on simulated cores", three(a), three(b)))
    }

    /// CSV with a row for each layer.
    pub fn csv(&self) -> String {
        let columns = "layer=name,shift,spikes_a,spikes_b,coincidence,van_rossum,victor_purpura,potential_rmse,\
                       sample=first_divergence.sample,timestep=first_divergence.timestep,\
                       neuron=first_divergence.neuron";
        csv(self.layers.iter().map(layer_json), columns)
    }

    fn attribution_text(&self) -> String {
        let Some(attribution) = self.attribution else { return String::new() };
        let have_shares = attribution.shares.iter().all(|share| share.share.is_some());
        let columns = SHARE_TEXT.iter().filter(|(heading, _)| have_shares || *heading != "share").copied();
        let table = table_of(&attribution.shares, &columns.collect::<Vec<_>>());
        let intro = format!(
            "causes: disagreement {} (1 - coincidence over all layers) over {}, from the trained network to the \
             machine. Each row is the network with one more cause added{}. without: the coincidence of the machine \
             without this cause",
            three(attribution.disagreement),
            count(self.attribution_samples as u64, "sample"),
            match have_shares {
                true => ", and its share is the mean over the forward and the reversed order",
                false => ". Causes cancel each other, so none has a share",
            }
        );
        format!("\n{}{table}\n{}", wrapped(&intro), blame(attribution, self.next))
    }

    /// A section of a Markdown document, with a chart under `picture`.
    pub fn markdown(&self, picture: &str) -> String {
        let (samples, input) = (count(self.samples as u64, "sample"), origin(self.input, self.seed));
        let (a, b) = self.other.map_or((self.against, self.model), |(other, _)| (self.model, other));
        let mut out = format!("{}, {samples} of {input}; a: {a}, b: {b} on simulated cores.\n\n", self.model);
        if let Some(classes) = &self.classes {
            let said = classes_text(classes);
            out += &format!("{}{}", said[..1].to_uppercase(), &said[1..]);
            out += &self.accuracy.map_or(String::new(), |(a, b)| format!("; accuracy {a:.4} (a), {b:.4} (b)"));
            out += ".\n\n";
        }
        if let Some(search) = self.found {
            let samples = count(search.samples as u64, "calibration sample");
            out += &format!("On {samples}:\n\n{}\n", markdown_of(&scores(search), &score_columns()));
        }
        if !self.fits.is_empty() {
            out += &format!("{}\n", markdown_of(self.fits, &FIT_COLUMNS));
        }
        out += &markdown_of(self.layers, &LAYER_COLUMNS);
        let Some(attribution) = self.attribution else { return out };
        out += &format!(
            "\nDisagreement {:.4} over {}:\n\n",
            attribution.disagreement,
            count(self.attribution_samples as u64, "sample")
        );
        out += &format!("![causes of {}]({picture})\n\n", self.model);
        out + &markdown_of(&attribution.shares, &SHARE_COLUMNS[..7])
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let on = self.target.map_or(String::new(), |target| format!(" of {target}"));
        let a = if self.source.is_some() { "the conversion, real numbers" } else { counterpart_text(self.against) };
        let mut out = wrapped(&match self.other {
            Some(other) => {
                let (a, b) = (name_with_role((self.model, self.role)), name_with_role(other));
                format!("{a} (a) and {b} as deployed on simulated cores{on} (b)")
            }
            None => format!("{} (a: {a}) and as deployed on simulated cores{on} (b)", self.model),
        });
        out += &wrapped(&format!("input: {}", origin(self.input, self.seed)));
        let accuracy = self.accuracy.map(|(a, b)| format!("; accuracy {} (a), {} (b)", three(a), three(b)));
        let classes = self.classes.as_ref().map(|classes| format!("; {}", classes_text(classes)));
        let samples = count(self.samples as u64, "sample");
        out += &wrapped(&format!("{samples}{}{}", classes.unwrap_or_default(), accuracy.unwrap_or_default()));
        if let Some((trained, command)) = &self.source {
            out += &wrapped(&format!(
                "{} was converted from {trained}, so a is the result of the conversion, not the trained network; \
                 compare with the trained network: {command}",
                self.model
            ));
        }
        if let Some(SearchResult { start, end, tried, samples, .. }) = self.found {
            let samples = count(*samples as u64, "calibration sample");
            out += &wrapped(&format!(
                "conversion: the best of {tried} on {samples}; coincidence {} there, {} before the search",
                three(end.coincidence),
                three(start.coincidence)
            ));
        }
        out += &format!("\n{}", table_of(self.layers, &[&LAYER_COLUMNS[..4], &TEXT_COLUMNS].concat()));
        if self.layers.iter().any(|row| row.shift != 0) {
            out += &wrapped(
                "shift: steps by which b answers later than a (negative: earlier); the comparison removes them",
            );
        }
        out += &self.attribution_text();
        if !self.files.is_empty() {
            out += &wrapped(&format!("written: {}", self.files.join(", ")));
        }
        out
    }
}

/// Sentence on the loss of a layer and its cause.
fn sentence(layer: &LayerLoss) -> String {
    let LayerLoss { name, spikes, disagreement, .. } = layer;
    if spikes.0 + spikes.1 == 0 {
        return format!("'{name}' is silent in both networks: nothing to compare.");
    }
    if !layer.is_lossy() {
        return format!("'{name}' loses almost nothing ({disagreement:.4} of its coincidence).");
    }
    let most = match layer.worst() {
        Some((cause, back)) => format!("most to {}; without these it loses {back:.3} less", cause.loss_text()),
        None => "to several causes together; removing any one restores little of it".to_string(),
    };
    format!("'{name}' loses {disagreement:.3} of its coincidence, {most}.")
}

/// Text on the losses of layers and classes, their causes, and the next command.
pub(super) fn blame(attribution: &Attribution, next: Option<&Suggestion>) -> String {
    let mut out: String = attribution.layers.iter().map(|layer| wrapped(&sentence(layer))).collect();
    if let (Some((cause, back)), Some(now)) = (attribution.worst_of_classes(), attribution.machine.class_agreement) {
        let words = cause.loss_text();
        let samples = count(attribution.samples as u64, "sample");
        out += &wrapped(&format!("Classes agree in {now:.3} of {samples}, in {:.3} without {words}.", now + back));
    }
    let lossy = attribution.layers.iter().any(LayerLoss::is_lossy);
    if let Some(remedy) = attribution.worst().filter(|_| lossy).and_then(Cause::remedy) {
        out += &wrapped(&format!("Remedy: {remedy}."));
    }
    if let Some(Suggestion { what, command, .. }) = next {
        out += &format!("{}{}\n", wrapped(&format!("next: a command that {what}")), shell_lines(command));
    }
    out
}

pub(super) fn next_json(next: &Suggestion) -> Value {
    json!({ "cause": next.cause.map(Cause::name), "what": next.what, "command": next.command })
}

pub(super) fn lost_json(layer: &LayerLoss) -> Value {
    let by_name =
        |each: &[(Cause, f64)]| each.iter().map(|(cause, loss)| (cause.name(), rounded(*loss))).collect::<Value>();
    json!({
        "name": layer.name, "disagreement": rounded(layer.disagreement), "causes": by_name(&layer.causes),
        "back": by_name(&layer.alone), "cause": layer.worst().map(|(cause, _)| cause.name()),
    })
}

/// SVG of both potentials around the first difference of spikes; `None` without either.
pub fn potentials(model: &str, layers: &[LayerRow]) -> Option<String> {
    let parted = layers.iter().filter_map(|row| {
        let (divergence, excerpt) = (row.comparison.first_divergence?, row.comparison.excerpt.as_ref()?);
        (!excerpt.a.is_empty() && !excerpt.b.is_empty()).then_some((row, divergence, excerpt))
    });
    let (row, divergence, excerpt) =
        parted.min_by_key(|(_, divergence, _)| (divergence.sample, divergence.timestep))?;
    let line = |name: &str, numbers: &[f64]| {
        let points = (excerpt.from..).map(f64::from).zip(numbers.iter().copied());
        Series::Line(name.to_string(), points.collect())
    };
    let end = f64::from(excerpt.from) + excerpt.a.len().max(excerpt.b.len()) as f64 - 1.0;
    fn spikes(name: &str, steps: &[u32], height: f64) -> Series {
        let points = steps.iter().map(|&step| (f64::from(step), height, String::new()));
        Series::Points(name.to_string(), points.collect())
    }
    let series = [
        line("a", &excerpt.a),
        line("b", &excerpt.b),
        spikes("spikes of a", &excerpt.spikes_a, 1.15),
        spikes("spikes of b", &excerpt.spikes_b, 1.25),
        Series::Line("threshold".to_string(), vec![(excerpt.from.into(), 1.0), (end, 1.0)]),
    ];
    let title = format!(
        "{model}: '{}' neuron {}, sample {}, first difference in step {}",
        row.name, divergence.neuron, divergence.sample, divergence.timestep
    );
    Some(plot::chart(&title, &Axis::linear("timestep of a"), &Axis::linear("potential in thresholds"), &series))
}

/// SVG of the causes as bars, forward and reversed.
pub fn bars(model: &str, attribution: &Attribution) -> String {
    let shares: Vec<Value> = attribution.shares.iter().map(AgreeReport::share_json).collect();
    results::agreement(&json!({ "model": model, "attribution": shares })).unwrap_or_default()
}
