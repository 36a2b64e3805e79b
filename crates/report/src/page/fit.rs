//! A mapping as JSON for a page: sites of its cores, their use, loads of links.

use serde_json::{Value, json};

use crate::charts::board::mostly;
use nsim_compile::Mapping;
use nsim_compile::explore::traffic::Links;
use nsim_ir::hardware::Target;
use nsim_ir::resource::Resource;

/// Cores with their use of each resource, and loaded links.
pub fn json(compiled: &Mapping, target: &Target, links: &Links) -> Value {
    let mesh = compiled.placement.mesh();
    let limits = target.limits();
    let resources = [Resource::Compartments, Resource::AxonsIn, Resource::AxonsOut, Resource::SynapseWords];
    let cores: Vec<Value> = compiled
        .partition
        .usage()
        .enumerate()
        .map(|(core, used)| {
            let site = compiled.placement.site(core);
            let (x, y) = mesh.tile(site);
            let needs = resources.map(|resource| used[resource]);
            let row = json!([core.0, site.chip, x, y, site.core, mostly(compiled, core).0]);
            let rest = needs.iter().map(|&need| json!(need)).chain([json!(used.synapses)]);
            row.as_array().into_iter().flatten().cloned().chain(rest).collect()
        })
        .collect();
    let (columns, rows) = (mesh.chips_x * mesh.width, mesh.chips_y * mesh.height);
    let mut loaded = Vec::new();
    for (x, y) in (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y))) {
        let ends = [(links.east_west(x, y), x + 1, y), (links.north_south(x, y), x, y + 1)];
        loaded.extend(
            ends.into_iter().filter(|end| end.0 > 0.0).map(|(load, to_x, to_y)| json!([x, y, to_x, to_y, load])),
        );
    }
    json!({
        "target": target.name(),
        "columns": ["core", "chip", "x", "y", "core of tile", "population", "compartments", "axons_in", "axons_out",
                    "synapse_words", "synapses"],
        "cores": cores, "limits": resources.map(|resource| limits[resource]), "links": loaded,
        "mesh": { "chips_x": mesh.chips_x, "chips_y": mesh.chips_y, "width": mesh.width, "height": mesh.height,
                  "cores_per_tile": mesh.cores_per_tile },
    })
}
