//! Constants for which a run is charged.
//!
//! Input: a [`EstimateInput`] and the name of a constant. Output: whether the run has a count that
//! multiplies the constant. Invariant: a constant that is not charged changes no figure. Where only
//! the longest of several parts counts, all their constants are charged.

use crate::deployment::Host;
use crate::estimate::EstimateInput;
use crate::job::Accounting;
use crate::transport::Transport;
use nsim_ir::hardware::constants::StepForm;

/// Whether a run has a count that multiplies this constant.
pub fn is_charged(case: &EstimateInput<'_>, constant: &str) -> bool {
    let (sum, hops, deployment) = (case.activity.sum(), case.activity.hops(), case.deployment);
    let timing = &case.meter.settings().timing;
    let (rails, x86) = (case.accounting == Accounting::Rails, deployment.x86_cores > 0);
    let profiler = case.accounting == Accounting::Profiler;
    // (21) has no term for routes and buffers.
    let follows = case.meter.tables()[case.preset].step == StepForm::Sum;
    let links = hops.total_links() > 0;
    match constant {
        "synapse_dense_energy" | "synapse_dense_time" => sum.events_dense > 0,
        "synapse_sparse_energy" | "synapse_sparse_time" => sum.events_sparse > 0,
        "synapse_update_energy" | "synapse_update_time" => sum.synaptic_updates > 0,
        "dendrite_energy" | "compartment_energy" | "compartment_time" => sum.visited > 0,
        "microcode_time" => sum.microcode > 0,
        "compartment_active_energy" | "compartment_active_time" => sum.active > 0,
        "spike_energy" | "spike_time" => sum.spikes > 0,
        "axon_out_energy" | "axon_out_time" => sum.messages_out > 0,
        "axon_in_energy" | "axon_in_time" => sum.messages_in > 0,
        "local_hop_energy" => hops.local > 0,
        "hop_ew_energy" => hops.east_west > 0,
        "hop_ns_energy" => hops.north_south > 0,
        "hop_chip_energy" => hops.chip > 0,
        "local_hop_time" => follows && sum.messages_in > 0,
        "hop_ew_time" => follows && hops.east_west > 0,
        "hop_ns_time" => follows && hops.north_south > 0,
        "hop_chip_time" => follows && hops.chip > 0,
        "link_time" => links,
        "link_chip_time" => hops.chip > 0,
        "link_buffer" => follows && links && timing.transport == Transport::Queued,
        "injection_time" => timing.streams > 0,
        "turn_time" => timing.turn,
        "chip_hop_time" => timing.chip_hops > 0,
        "reset_word_time" => timing.reset.count > 0,
        "core_static_power" => profiler,
        "x86_static_ratio" => profiler && x86,
        "x86_clock_power" => x86 && (profiler || rails),
        "x86_active_power" => profiler && x86,
        "x86_injecting_share" => profiler && x86 && deployment.host != Host::None,
        "core_rails_power" => !profiler,
        "unit_power" => case.accounting == Accounting::Unit,
        "chip_boot_power" => rails,
        "x86_on_power" => rails && x86,
        "x86_rails_power" => !profiler && deployment.x86_at_work() > 0,
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::constants::CostTable;
    use crate::constants::tests::preset;
    use crate::deployment::{Deployment, tests::paper};
    use crate::estimate::{estimate, tests::run};
    use crate::model::tests::any_step;
    use nsim_ir::hardware::constants::Constants;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        /// A run's figures change with a constant only if the run is charged for the constant.
        #[test]
        fn a_constant_that_is_not_charged_changes_no_figure(
            steps in proptest::collection::vec(any_step(2), 1..4), rails in any::<bool>(), alone in any::<bool>(),
            preset_name in prop_oneof![Just("loihi1-evidence"), Just("loihi2-modelled")],
        ) {
            let deployment = match alone {
                true => Deployment { x86_cores: 0, x86_chips: 0, x86_working: 0, host: Host::None, ..paper() },
                false => paper(),
            };
            let accounting = if rails { Accounting::Rails } else { Accounting::Profiler };
            let figures = |constants: &Constants, constant: &str| {
                let (activity, meter) = run(&steps, vec![CostTable::new(constants).unwrap()], None);
                let case = EstimateInput { accounting, ..EstimateInput::new(&activity, &meter, &deployment) };
                let figures = estimate(&case);
                ((figures.rows, figures.breakdown_pj, figures.time_us), is_charged(&case, constant))
            };
            let constants = preset(preset_name);
            for name in Constants::NAMES {
                let mut other = constants.clone();
                let constant = other.get_mut(name).unwrap();
                constant.value = (constant.value.value + 1.0).into();
                let (before, charged) = figures(&constants, name);
                prop_assert!(charged || figures(&other, name).0 == before, "{name}");
            }
        }
    }
}
