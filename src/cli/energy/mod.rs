//! `nsim energy`: arguments -> a simulated run -> its report.
//!
//! [`workload`] runs, [`mod@evaluate`] prices through `nsim_energy`.

pub mod args;
pub mod evaluate;
pub mod workload;

use std::path::PathBuf;

use crate::cli::args::steps;
use crate::cli::context::{Answer, Context, Format};
use crate::cli::energy::args::EnergyArgs;
use crate::cli::energy::evaluate::evaluate;
use crate::cli::output;
use nsim_energy::evaluate::Evaluation;
use nsim_energy::sanafe::Export;
use nsim_energy::workload::Workload;
use nsim_files as io;
use nsim_session::error::Error;

pub fn run(args: &EnergyArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, &args.plot, context)?;
    io::write::check_all_free(args.export_sanafe.iter().flat_map(|folder| sanafe_files(folder)), context.force)?;
    args.steps.iter().try_for_each(|path| steps::check(path, context.force))?;
    let reported = |workload: &Workload<'_>, evaluated: Evaluation| {
        let Evaluation { energy, run, deployment } = evaluated;
        if let (Some(path), Some(svg)) = (&args.plot, nsim_report::charts::results::hardware(&energy.json())) {
            output::write_picture(path, &svg, context)?;
        }
        if let Some(folder) = &args.export_sanafe {
            let channels = workload.compiled.one.channels();
            let (table, sample) = (&run.meter.tables()[0], workload.samples()[0].copies(workload.copies, channels));
            let tiles_used = deployment.tiles_used;
            let export = Export { compiled: workload.compiled, table, sample: &sample, tiles_used };
            let mut batch = io::write::Batch::new(context.force);
            for (path, text) in sanafe_files(folder).iter().zip(export.files()?) {
                batch.add(path, |out| out.write_all(text.as_bytes()))?;
            }
            batch.commit()?;
        }
        if !taken {
            let text = || if args.full { energy.text() } else { energy.headline() };
            let csv = || if context.format == Format::Csv { energy.csv() } else { energy.paper_csv() };
            output::print(context.format, text, || energy.json(), csv)?;
        }
        let paper = matches!(context.format, Format::Markdown | Format::Latex | Format::Csv);
        if paper && energy.early_exit.is_some() {
            tracing::warn!("this format has no early exit; text and JSON have it");
        }
        Ok(Answer::Yes)
    };
    evaluate(&args.cost, args.steps.as_deref(), context, reported)
}

/// Paths of the files of an export.
fn sanafe_files(folder: &std::path::Path) -> [PathBuf; 2] {
    ["arch.yaml", "snn.yaml"].map(|name| folder.join(name))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use nsim_files::network::USUAL_TARGET;

    use super::*;
    use nsim_cost::job::{Accounting, Convention, Mode};
    use nsim_energy::published::scenario::shipped_for;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: EnergyArgs,
    }

    fn args(line: &[&str]) -> Result<EnergyArgs, clap::Error> {
        Line::try_parse_from([&["energy"], line].concat()).map(|line| line.args)
    }

    #[test]
    fn defaults_are_those_of_the_contract() {
        let args = args(&[]).unwrap().cost;
        let scenario = shipped_for(&args.job.model).unwrap().unwrap();
        assert_eq!((scenario.copies.value, scenario.target), (32, USUAL_TARGET.to_string()));
        assert_eq!(
            (args.job.model.as_str(), args.job.target.clone(), args.copies, args.input.repeat),
            ("vtsnn-slip", None, None, 1)
        );
        assert_eq!(
            (args.deployment, args.mode, args.convention, args.accounting),
            (None, Mode::Offline, Convention::Physical, Accounting::Profiler)
        );
    }

    #[test]
    fn arguments_parse_or_are_refused() {
        let given =
            args(&["m.ron", "--samples", "3..5", "--deployment", "saved.ron", "--baseline", "a,b"]).unwrap().cost;
        assert_eq!((given.input.samples, given.deployment), (Some(3..5), Some("saved.ron".to_string())));
        assert_eq!(given.baseline, Some(vec!["a".to_string(), "b".to_string()]));
        assert_eq!(args(&["--baseline"]).unwrap().cost.baseline, Some(vec![]));
        for wrong in
            [["--samples", "5..3"], ["--samples", "5"], ["--copies", "0"], ["--repeat", "0"], ["--mode", "fast"]]
        {
            assert!(args(&wrong).is_err(), "{wrong:?}");
        }
    }
}
