//! The result of `nsim bench scale` as text, JSON and CSV.

use serde_json::{Value, json};

use super::step::{rounded, significant};
use nsim_energy::environment::Environment;
use nsim_files::table::{Column, csv_of, table_of};
use nsim_study::scale::measured::{MeasuredExchange, MeasuredStep};
use nsim_study::scale::model::{COMPASS, Costs, ModelledStep, ScaleJob};

/// A job and what it takes on some numbers of ranks.
#[derive(Debug)]
pub struct Modelled {
    /// What is said of it.
    pub name: &'static str,
    /// The job.
    pub job: ScaleJob,
    /// On each number of ranks.
    pub steps: Vec<ModelledStep>,
}

/// Everything that the report says.
#[derive(Debug)]
pub struct ScaleReport<'a> {
    /// Where it was measured.
    pub environment: &'a Environment,
    /// The network that was measured.
    pub network: &'a str,
    /// Steps, on one rank first.
    pub measured: &'a [MeasuredStep],
    /// Exchanges by themselves; none on one rank.
    pub exchanges: &'a [MeasuredExchange],
    /// What follows from them, and the network that is given.
    pub costs: Costs,
    /// What is modelled.
    pub modelled: &'a [Modelled],
}

/// A row of the table of CSV.
struct Row<'a>(&'a Modelled, &'a ModelledStep);

impl ScaleReport<'_> {
    /// `nsim.bench/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let measured = self.measured.iter().map(|step| {
            json!({
                "ranks": step.ranks, "us_per_timestep": rounded(step.timing.us_per_timestep),
                "spread": rounded(step.timing.spread), "fastest_us": rounded(step.timing.fastest),
                "compartments": step.compartments, "synapses": step.synapses,
                "spikes_per_step": rounded(step.spikes), "mib_per_rank": rounded(mib(step.bytes)),
                "peak_mib": step.peak_mib.map(rounded),
            })
        });
        let exchanges =
            self.exchanges.iter().map(|exchange| json!({ "ids": exchange.ids, "us": rounded(exchange.us) }));
        let rows = self.modelled.iter().flat_map(|of| {
            of.steps.iter().map(move |step| {
                json!({
                    "job": of.name, "ranks": step.ranks, "compute_us": rounded(step.compute_us),
                    "exchange_us": rounded(step.exchange_us), "step_us": rounded(step.step_us),
                    "efficiency": rounded(step.efficiency), "memory_gib": rounded(step.memory_gib),
                    "replicated_gib": rounded(step.replicated_gib), "messages": step.messages,
                })
            })
        });
        json!({
            "schema": "nsim.bench/1",
            "name": "scale",
            "environment": self.environment,
            "network": self.network,
            "measured": measured.collect::<Vec<_>>(),
            "exchanges": exchanges.collect::<Vec<_>>(),
            "costs": self.costs,
            "jobs": self.modelled.iter().map(|of| json!({ "name": of.name, "job": of.job })).collect::<Vec<_>>(),
            "rows": rows.collect::<Vec<_>>(),
            "published": [COMPASS],
        })
    }

    /// A row for each number of ranks of each job.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let rows: Vec<Row<'_>> =
            self.modelled.iter().flat_map(|of| of.steps.iter().map(move |step| Row(of, step))).collect();
        let columns: [Column<Row<'_>>; 7] = [
            ("job", |row| row.0.name.to_string()),
            ("ranks", |row| row.1.ranks.to_string()),
            ("compute_us", |row| rounded(row.1.compute_us).to_string()),
            ("exchange_us", |row| rounded(row.1.exchange_us).to_string()),
            ("step_us", |row| rounded(row.1.step_us).to_string()),
            ("efficiency", |row| rounded(row.1.efficiency).to_string()),
            ("memory_gib", |row| rounded(row.1.memory_gib).to_string()),
        ];
        csv_of(&rows, &columns)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let columns: [Column<MeasuredStep>; 7] = [
            ("ranks", |step| step.ranks.to_string()),
            ("us a step", |step| significant(step.timing.us_per_timestep)),
            ("quartiles apart", |step| significant(step.timing.spread)),
            ("fastest", |step| significant(step.timing.fastest)),
            ("spikes", |step| format!("{:.0}", step.spikes)),
            ("MiB a rank", |step| significant(mib(step.bytes))),
            ("peak MiB", |step| step.peak_mib.map_or(String::new(), |peak| format!("{peak:.0}"))),
        ];
        let mut out = format!("{}\n\nMeasured: {}\n", self.environment, self.network);
        out += &format!("{}\n", table_of(self.measured, &columns, 0));
        if let [one, .., all] = self.measured {
            let times = one.timing.us_per_timestep / all.timing.us_per_timestep;
            let share = 100.0 * all.bytes as f64 / one.bytes.max(1) as f64;
            out += &format!("{} ranks: {times:.2} times as fast, {share:.0} % of the memory a rank\n", all.ranks);
        }
        for MeasuredExchange { ids, us } in self.exchanges {
            out += &format!("an exchange of {ids} ids each way: {} us\n", significant(*us));
        }
        let Costs { compartment_ns, id_ns, latency_us, overhead_us, bandwidth_gb_s, replicated_bytes, synapse_bytes } =
            self.costs;
        out += &format!(
            "\nA rank: {} ns a compartment and step, {} ns an id, {} bytes a compartment on every rank, {} a synapse\n\
             The network: {} us, {} us a message, {} GB/s\n",
            significant(compartment_ns),
            significant(id_ns),
            significant(replicated_bytes),
            significant(synapse_bytes),
            significant(latency_us),
            significant(overhead_us),
            significant(bandwidth_gb_s),
        );
        for of in self.modelled {
            let columns: [Column<ModelledStep>; 7] = [
                ("ranks", |step| step.ranks.to_string()),
                ("compute us", |step| significant(step.compute_us)),
                ("exchange us", |step| significant(step.exchange_us)),
                ("us a step", |step| significant(step.step_us)),
                ("efficiency", |step| format!("{:.2}", step.efficiency)),
                ("GiB a rank", |step| significant(step.memory_gib)),
                ("of it replicated", |step| significant(step.replicated_gib)),
            ];
            out += &format!("\nModelled: {}\n{}\n", of.name, table_of(&of.steps, &columns, 0));
        }
        out += &format!(
            "\nPublished: {}, {}: {:.3e} processors, {:.2e} neurons, {:.1e} synapses, {} Hz: {:.3e} us a step of 1 ms, \
             {} GiB a processor ({})\n",
            COMPASS.work,
            COMPASS.machine,
            COMPASS.processors,
            COMPASS.neurons,
            COMPASS.synapses,
            COMPASS.rate_hz,
            COMPASS.step_us,
            COMPASS.memory_gib,
            COMPASS.source
        );
        out
    }
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1u32 << 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_modelled_and_what_is_published_stand_side_by_side() {
        let costs = Costs {
            compartment_ns: 10.0,
            id_ns: 1.0,
            latency_us: 2.0,
            overhead_us: 0.5,
            bandwidth_gb_s: 10.0,
            replicated_bytes: 20.0,
            synapse_bytes: 5.0,
        };
        let job = ScaleJob { compartments: 1e9, fan_out: 64.0, rate: 0.01, local: 0.0, neighbours: None };
        let steps = [10, 10_000].map(|ranks| costs.step(&job, ranks)).to_vec();
        let modelled = [Modelled { name: "even", job, steps }];
        let report = ScaleReport {
            environment: &Environment::here(),
            network: "random-32k",
            measured: &[],
            exchanges: &[],
            costs,
            modelled: &modelled,
        };
        assert!(report.text().contains("Modelled: even") && report.text().contains("Compass"));
        let json = report.json();
        assert_eq!((&json["name"], &json["rows"][1]["ranks"]), (&json!("scale"), &json!(10_000)));
        assert_eq!(json["published"][0]["step_us"], json!(388e3));
        assert_eq!(report.csv().unwrap().lines().count(), 3);
    }
}
