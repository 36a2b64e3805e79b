//! `--check IN.npy=OUT.npy`: the tool's own spikes, compared with the reference engine's.
//!
//! Input: spikes and the output's spikes that the tool recorded on them. Output: a line, where they
//! are equal; else the first difference, and how many values differ by the conventions of each
//! tool.

use std::path::{Path, PathBuf};

use nsim_agree::compare::output_layer;
use nsim_agree::recording::{RecordingResult, compare_recording};
use nsim_files::network::Network;
use nsim_import::foreign::{self, Options, Reading, Tool};
use nsim_import::spikes::read_source;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_session::error::Error;
use nsim_session::front::real_and_integers;
use nsim_session::inputs;

/// Spikes for a network, and those of its output.
#[derive(Debug, Clone)]
pub struct RecordingPair {
    input: String,
    output: PathBuf,
}

/// Parses `IN.npy=OUT.npy`.
pub fn recording_pair(text: &str) -> Result<RecordingPair, String> {
    match text.rsplit_once('=') {
        Some((input, output)) if !input.is_empty() && !output.is_empty() => {
            Ok(RecordingPair { input: input.to_string(), output: output.into() })
        }
        _ => Err("write IN.npy=OUT.npy: spikes of the input, and the tool's spikes of the output".to_string()),
    }
}

impl RecordingPair {
    /// Compares the recording with a network.
    fn compare(&self, network: &Network) -> Result<RecordingResult, Error> {
        let (graph, integers) = real_and_integers(network)?;
        let stimulus = inputs::stimulus(&integers, std::slice::from_ref(&self.input), None, None)?;
        let recorded = read_source(&self.output, u64::from(output_layer(&integers).count))?;
        let samples: Vec<_> = stimulus.samples.iter().collect();
        Ok(compare_recording(&graph, &integers, &samples, &recorded)?)
    }

    /// Lines on a network of a file: whether it spikes as recorded, and by which conventions it
    /// would.
    ///
    /// # Errors
    /// As [`compare_recording`]; files that cannot be read.
    pub fn lines(&self, network: &Network, file: &Path, options: &Options) -> Result<(bool, Vec<String>), Error> {
        let result = self.compare(network)?;
        let is_equal = result.differing == 0;
        let mut lines = result.lines();
        lines[0] = format!("{}: {}", self.output.display(), lines[0]);
        if !is_equal {
            lines.extend(self.by_tool(file, options));
        }
        Ok((is_equal, lines))
    }

    /// A line for each tool by whose conventions the file can be read.
    pub fn by_tool(&self, file: &Path, options: &Options) -> Vec<String> {
        let mut rows = Vec::new();
        for tool in Tool::ALL {
            let reading = Reading { tool: Some(tool), ..options.reading };
            let read = foreign::read(file, &Options { reading, ..options.clone() });
            let network = read.and_then(|imported| imported.model.build(file));
            let result = network.map_err(Error::from).and_then(|network| self.compare(&network));
            rows.extend(
                result.ok().map(|result| (result.differing, format!("with --from {}: {}", tool.name(), result.text()))),
            );
        }
        rows.sort_by_key(|(differing, _)| *differing);
        rows.into_iter().map(|(_, row)| row).collect()
    }
}

/// An error of reading a file, with what each tool's conventions would give.
pub fn with_rows(mut problem: Diagnostic, rows: &[String]) -> Diagnostic {
    if !rows.is_empty() {
        let help = problem.help.take().map_or(String::new(), |help| format!("{help}. "));
        problem.help = Some(format!("{help}On the recording, {}", rows.join("; ")).into());
    }
    problem
}
