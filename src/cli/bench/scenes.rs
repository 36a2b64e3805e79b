//! The scenes of the paper's tasks, which the cells of its tables share.
//!
//! Input: names of cells, the number of scenes. Output: each cell with the scenes of its task, made
//! once per task. Errors: as for training files and scenes.

use nsim_ir::base::diagnostic::SourceText;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_session::error::{Error, Result};
use nsim_session::inputs::{stimulus, translate_sample};
use nsim_study::published::cells::{Cell, cells};
use nsim_train::job::Job as Training;

/// Scenes of a task as input of the network with both senses, made once for all its cells.
pub(super) struct Scenes {
    task: &'static str,
    network: Quantised,
    stimulus: Stimulus,
}

impl Scenes {
    fn new(cell: Cell, scenes: Option<u32>) -> Result<Self> {
        let both = cells().find(|other| other.task == cell.task && other.modality == "both").unwrap_or(cell);
        let job = Training::new(SourceText::new(both.training.path, both.training.text), None, None)?;
        let network = job.inputs()?;
        let sources: Vec<String> = job.file.train.iter().map(|source| with_scenes(source, scenes)).collect();
        let stimulus = stimulus(&network, &sources, None, None)?;
        Ok(Scenes { task: cell.task, network, stimulus })
    }

    /// Scenes as input of a network with some of the senses.
    pub(super) fn samples_for(&self, network: &Quantised) -> Result<Vec<Sample>> {
        let seen = self.stimulus.samples.iter().map(|sample| translate_sample(network, &self.network, sample));
        let unlike = || Error::Fault(format!("the inputs of a network of task {} do not match its scenes", self.task));
        seen.collect::<Option<_>>().ok_or_else(unlike)
    }
}

/// A source with its number of scenes replaced.
fn with_scenes(source: &str, scenes: Option<u32>) -> String {
    match (scenes, source.split_once("samples=")) {
        (Some(scenes), Some((before, after))) => {
            let rest = after.trim_start_matches(|digit: char| digit.is_ascii_digit());
            format!("{before}samples={scenes}{rest}")
        }
        _ => source.to_string(),
    }
}

/// Calls `each` with every selected cell and the scenes of its task.
pub(super) fn each_cell(
    names: &[&str],
    number: Option<u32>,
    mut each: impl FnMut(Cell, &Scenes) -> Result<()>,
) -> Result<()> {
    let mut scenes: Option<Scenes> = None;
    for cell in cells().filter(|cell| names.is_empty() || names.contains(&cell.name())) {
        let scenes = match scenes.take().filter(|scenes| scenes.task == cell.task) {
            Some(kept) => scenes.insert(kept),
            None => scenes.insert(Scenes::new(cell, number)?),
        };
        each(cell, scenes)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::cli::bench::scenes::*;

    #[test]
    fn sources_take_another_number_of_scenes() {
        let source = "scene:slip?samples=1000&seed=1&shear=0.32";
        assert_eq!(with_scenes(source, Some(20)), "scene:slip?samples=20&seed=1&shear=0.32");
        assert_eq!((with_scenes(source, None), with_scenes("a", Some(2))), (source.to_string(), "a".to_string()));
    }
}
