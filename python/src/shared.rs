//! A compiled network with its image, which runs and energies of one mapping share.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nsim::compile::Mapping;
use nsim::files::network::Network;
use nsim::ir::base::warning::Warning;
use nsim::ir::hardware::Target;
use nsim::machine::Image;
use nsim::session::samples::{Division, lay_out};

use crate::error::in_python;

/// A mapping that runs and energies share.
pub struct Shared {
    /// The model, as the user named it.
    pub model: String,
    /// Scene of the model.
    pub scene: Option<String>,
    /// Target of the mapping.
    pub target: Target,
    /// The network as in its file.
    pub network: Arc<Network>,
    compiled: Mapping,
    /// Image of the program for one thread; none where threads share a sample, as an image depends
    /// on their number.
    image: Option<Arc<Image>>,
    warned: AtomicBool,
}

impl Shared {
    /// Makes a mapping of this network, with its image where one thread runs it.
    pub fn new(model: &str, network: &Arc<Network>, compiled: Mapping, target: Target) -> Self {
        let division = Division::new(&compiled.program, usize::MAX);
        let image = match division.shards {
            1 => lay_out(&compiled.program, division).ok(),
            _ => None,
        };
        let scene = network.file().scene.clone();
        Shared {
            model: model.to_string(),
            scene,
            target,
            network: network.clone(),
            compiled,
            image,
            warned: AtomicBool::new(false),
        }
    }

    /// The compiled network.
    pub fn compiled(&self) -> &Mapping {
        &self.compiled
    }

    /// Warnings of the network, which a run repeats.
    pub fn warnings(&self) -> Vec<Warning> {
        in_python(self.compiled.one.parts().warnings.clone())
    }

    /// Whether warnings of this network are still to be issued; true only in the first call.
    pub fn warns(&self) -> bool {
        !self.warned.swap(true, Ordering::Relaxed)
    }

    /// Image of the program for runs of this division.
    pub fn image(&self, division: Division) -> Option<&Arc<Image>> {
        self.image.as_ref().filter(|_| division.shards == 1)
    }
}
