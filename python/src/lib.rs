//! The Python module `nsim._nsim`, whose items the package `nsim` exports.
//!
//! Input: names, paths, NumPy arrays. Output: Python objects around objects of the library. Only
//! the library computes figures, so they equal the command line's. Errors: `nsim.Error` with the
//! diagnostic's code, place and help. Work runs without the interpreter's lock.

mod agree;
mod arrays;
mod bench;
mod convert;
mod energy;
mod error;
mod events;
mod html;
mod keywords;
mod mapping;
mod memory;
mod network;
mod projections;
mod run;
mod session;
mod shared;
mod spikes;
mod steering;
mod sweep;
mod train;
mod value;
mod work;

use pyo3::prelude::*;

#[pymodule]
fn _nsim(module: &Bound<'_, PyModule>) -> PyResult<()> {
    work::loaded();
    module.add("Error", module.py().get_type::<error::Error>())?;
    module.add("Warning", module.py().get_type::<error::Warning>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<network::Network>()?;
    module.add_class::<mapping::Mapping>()?;
    module.add_class::<run::Run>()?;
    module.add_class::<session::Session>()?;
    module.add_class::<session::Snapshot>()?;
    module.add_class::<session::Population>()?;
    module.add_class::<session::Values>()?;
    module.add_class::<energy::Energy>()?;
    module.add_class::<events::Events>()?;
    module.add_class::<agree::Agreement>()?;
    module.add_class::<convert::Conversion>()?;
    module.add_class::<train::Training>()?;
    module.add_function(wrap_pyfunction!(network::load, module)?)?;
    module.add_function(wrap_pyfunction!(network::from_bytes, module)?)?;
    module.add_function(wrap_pyfunction!(network::from_nodes, module)?)?;
    module.add_function(wrap_pyfunction!(network::real_spikes, module)?)?;
    module.add_function(wrap_pyfunction!(network::check_recording, module)?)?;
    module.add("TOOLS", nsim::import::foreign::Tool::ALL.map(nsim::import::foreign::Tool::name))?;
    module.add_function(wrap_pyfunction!(train::train, module)?)?;
    module.add_function(wrap_pyfunction!(sweep::sweep_len, module)?)?;
    module.add_function(wrap_pyfunction!(sweep::sweep_part, module)?)?;
    module.add_function(wrap_pyfunction!(sweep::sweep_merged, module)?)
}
