//! The result of `nsim agree` with several model files: one table, a row for each layer of each
//! network.
//!
//! Input: comparisons of networks in integers with the same trained network. Output: text, JSON and
//! CSV. A layer in which neither network spikes is not compared.

use serde_json::{Value, json};

use super::agree::{is_silent, layer_json};
use crate::origin;
use nsim_agree::compare::{Agreement, LayerRow};
use nsim_files::table::{Column, count, csv_of, four, or_empty, table_of, wrapped};

/// A network and its agreement with the trained one.
#[derive(Debug)]
pub struct ComparedNetwork {
    /// Its file.
    pub against: String,
    /// Its name.
    pub name: String,
    /// Number of its cores.
    pub cores: usize,
    /// The comparison.
    pub agreement: Agreement,
}

impl ComparedNetwork {
    fn class_agreement(&self) -> Option<f64> {
        self.agreement.classes.and_then(|classes| classes.agreement())
    }

    fn compared(&self) -> Option<usize> {
        self.agreement.classes.map(|classes| classes.compared)
    }
}

/// Data of the report.
#[derive(Debug)]
pub struct SideBySideReport<'a> {
    /// The trained network's name.
    pub model: &'a str,
    /// Sources of the samples.
    pub input: &'a [String],
    /// Their seed, when they had one.
    pub seed: Option<u64>,
    /// Number of samples.
    pub samples: usize,
    /// The other networks, in the order of the command.
    pub networks: Vec<ComparedNetwork>,
}

/// A layer of the trained network, or of a network that is compared with it.
struct Row<'a> {
    against: &'a str,
    accuracy: Option<f64>,
    compared: Option<&'a ComparedNetwork>,
    layer: &'a LayerRow,
}

impl Row<'_> {
    fn figure(&self, of: fn(&LayerRow) -> f64) -> String {
        match self.compared {
            None => String::new(),
            Some(_) if is_silent(self.layer) => "nothing to compare".to_string(),
            Some(_) => four(of(self.layer)),
        }
    }
}

fn columns<'a>() -> [Column<Row<'a>>; 10] {
    [
        ("network", |row| row.against.to_string()),
        ("accuracy", |row| or_empty(row.accuracy.map(four))),
        ("classes agree", |row| or_empty(row.compared.and_then(ComparedNetwork::class_agreement).map(four))),
        ("of samples", |row| or_empty(row.compared.and_then(ComparedNetwork::compared))),
        ("layer", |row| row.layer.name.clone()),
        ("spikes", |row| {
            let tally = &row.layer.comparison.tally;
            if row.compared.is_some() { tally.spikes_b } else { tally.spikes_a }.to_string()
        }),
        ("coincidence", |row| row.figure(|row| row.comparison.tally.coincidence())),
        ("van Rossum", |row| row.figure(|row| row.comparison.tally.van_rossum())),
        ("Victor-Purpura", |row| row.figure(|row| row.comparison.tally.victor_purpura())),
        ("potential rmse", |row| {
            or_empty(row.compared.and_then(|_| row.layer.comparison.tally.potential_rmse()).map(four))
        }),
    ]
}

impl SideBySideReport<'_> {
    /// The least share of samples of the same class.
    pub fn class_agreement(&self) -> Option<f64> {
        let each = self.networks.iter().map(ComparedNetwork::class_agreement);
        each.collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::min)
    }

    /// Whether the spikes of all networks equal the trained one's, and there are some.
    pub fn exact(&self) -> bool {
        self.networks.iter().all(|network| {
            let layers = &network.agreement.layers;
            layers.iter().any(|row| row.comparison.tally.spikes_a > 0)
                && layers.iter().all(|row| row.comparison.first_divergence.is_none())
        })
    }

    /// The trained network first, then each of the others.
    fn rows(&self) -> Vec<Row<'_>> {
        let trained = self.networks.first().map(|network| ("as trained", None, network));
        let others = self.networks.iter().map(|network| (network.against.as_str(), Some(network), network));
        let all = trained.into_iter().chain(others).flat_map(|(against, compared, network)| {
            let accuracy = network.agreement.accuracy.map(|(a, b)| if compared.is_some() { b } else { a });
            network.agreement.layers.iter().map(move |layer| Row { against, accuracy, compared, layer })
        });
        all.collect()
    }

    /// `nsim.agree/1`; `layers` has the rows of all networks, each with its file.
    pub fn json(&self) -> Value {
        let layers = self.networks.iter().flat_map(|network| {
            network.agreement.layers.iter().map(|row| {
                let mut object = layer_json(row);
                object["against"] = network.against.as_str().into();
                object
            })
        });
        let networks = self.networks.iter().map(|network| {
            json!({
                "against": network.against, "model": network.name, "cores": network.cores,
                "compared": network.compared(), "class_agreement": network.class_agreement(),
                "accuracy_a": network.agreement.accuracy.map(|(trained, _)| trained),
                "accuracy_b": network.agreement.accuracy.map(|(_, deployed)| deployed),
            })
        });
        json!({
            "schema": "nsim.agree/1", "model": self.model,
            "against": self.networks.iter().map(|network| network.against.as_str()).collect::<Vec<_>>(),
            "input": self.input, "seed": self.seed, "samples": self.samples,
            "compared": self.networks.iter().map(ComparedNetwork::compared).min().flatten(),
            "class_agreement": self.class_agreement(), "networks": networks.collect::<Vec<_>>(),
            "layers": layers.collect::<Vec<_>>(), "conversion": null, "attribution": [],
        })
    }

    /// A row for each layer of each network.
    pub fn csv(&self) -> String {
        csv_of(&self.rows(), &columns())
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let mut out = wrapped(&format!("{} as trained, and others on simulated cores", self.model));
        out += &wrapped(&format!("input: {}", origin(self.input, self.seed)));
        out += &format!("{}\n\n", count(self.samples as u64, "sample"));
        let all = columns();
        let layer: Column<Row<'_>> = ("network and layer", |row| format!("{} {}", row.against, row.layer.name));
        out + &table_of(&self.rows(), &[layer, all[1], all[2], all[3], all[5], all[6], all[9]])
    }
}
