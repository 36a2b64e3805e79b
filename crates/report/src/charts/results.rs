//! Pictures of results: from the JSON objects that commands print.
//!
//! Input: a result of `nsim energy`, `bench pareto`, `map --pareto` or `agree`. Output: an SVG
//! text, or none when the result lacks the drawn values. A command draws its own result by the same
//! function, so a stored one looks the same.

use serde_json::Value;

use super::draw::Axis;
use super::plot;
use nsim_files::table::{count, three};

fn number(value: &Value) -> Option<f64> {
    value.as_f64().filter(|number| number.is_finite())
}

fn words(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn rows(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A model on its target.
fn subject(result: &Value) -> String {
    format!("{} on {}", words(&result["model"]), words(&result["target"]))
}

/// Positive parts of an object of numbers, with spaces for underscores.
fn parts(value: &Value) -> Vec<(String, f64)> {
    let entries = value.as_object().into_iter().flatten();
    entries
        .filter_map(|(name, part)| Some((name.replace('_', " "), number(part).filter(|part| *part > 0.0)?)))
        .collect()
}

/// Power, time, energy and energy-delay product of a timestep on all hardware of `nsim.energy/1`, a
/// panel each, with intervals; the name of hardware has the source of its figures.
pub fn hardware(result: &Value) -> Option<String> {
    let totals: Vec<&Value> = rows(&result["rows"]).iter().filter(|row| row["unit"] == "total").collect();
    let name = |row: &&Value| {
        let power = match (words(&row["power_source"]), words(&row["source"])) {
            ("assumed", _) => ", power assumed",
            (_, "published") if words(&result["convention"]) == "physical" => ": power x time",
            _ => "",
        };
        format!("{}\n({}{power})", words(&row["hardware"]), words(&row["source"]))
    };
    let names: Vec<String> = totals.iter().map(name).collect();
    let (energy, edp, unit) = match words(&result["convention"]) {
        "published" => ("energy (mW/steps)", "EDP (pJ s)", 1.0),
        _ => ("energy (uJ)", "EDP (nJ s)", 1e-3),
    };
    let columns = [
        ("power (mW)", "total_mw", 1.0),
        ("time (us)", "latency_us", 1.0),
        (energy, "energy_uj", 1.0),
        (edp, "edp_pjs", unit),
    ];
    let columns = columns.map(|(name, key, unit)| {
        let number = |figure: &Value| Some(number(figure)? * unit);
        let interval = |row: &Value| Some((number(&row["low"][key])?, number(&row["high"][key])?));
        (name.to_string(), totals.iter().map(|row| Some((number(&row[key])?, interval(row)))).collect())
    });
    let copies = count(result["copies"].as_u64().unwrap_or_default(), "copy");
    let mode = if result["mode"] == "realtime" { "real time" } else { words(&result["mode"]) };
    let (subject, deployment) = (subject(result), words(&result["deployment"]));
    let title = format!("{subject}: a timestep of one copy, {copies} ({deployment}), {mode}; lines: intervals");
    totals.iter().any(|row| number(&row["energy_uj"]).is_some()).then(|| plot::panels(&title, &names, &columns))
}

/// Energy of a timestep of `nsim.energy/1` by part: all, and dynamic energy of the neuron cores.
pub fn energy(result: &Value) -> Option<String> {
    let chip = &rows(&result["rows"]).first()?["hardware"];
    let unit = |unit: &str| rows(&result["rows"]).iter().find(|row| row["hardware"] == *chip && row["unit"] == unit);
    let (x86, neuron, total) = (unit("x86")?, unit("neuron")?, unit("total")?);
    let powers = [
        ("x86 static", number(&x86["static_mw"])?),
        ("x86 busy", number(&x86["dynamic_mw"])?),
        ("neuron static", number(&neuron["static_mw"])?),
        ("neuron dynamic", number(&neuron["dynamic_mw"])?),
    ];
    let parts = parts(&result["breakdown_pj_per_timestep"]);
    fn share(value: f64, total: f64) -> f64 {
        if total > 0.0 { 100.0 * value / total } else { 0.0 }
    }
    let (all, dynamic): (f64, f64) = (powers.iter().map(|(_, mw)| mw).sum(), parts.iter().map(|(_, pj)| pj).sum());
    let mut series: Vec<(String, Vec<f64>)> =
        powers.iter().map(|(name, mw)| ((*name).to_string(), vec![share(*mw, all), 0.0])).collect();
    series.extend(parts.iter().map(|(name, pj)| (name.clone(), vec![0.0, share(*pj, dynamic)])));
    let title = format!("{}: energy of a timestep by part", subject(result));
    let whole = format!("all: {} uJ", three(number(&total["energy_uj"])?));
    // Events cost little compared with static power, and less than a microjoule.
    let of_events = match dynamic / 1e6 {
        uj if uj < 0.1 => format!("neuron dynamic: {} nJ", three(uj * 1e3)),
        uj => format!("neuron dynamic: {} uJ", three(uj)),
    };
    Some(plot::stacked(&title, "share (%)", &[whole, of_events], &series))
}

/// Breakdown of the time of a timestep, of `nsim.energy/1`: a bar for each part.
pub fn time(result: &Value) -> Option<String> {
    let parts = parts(&result["time_us_per_timestep"]);
    let total: f64 = parts.iter().map(|(_, us)| us).sum();
    let title = format!("{}: time of a timestep by part, {} us", subject(result), three(total));
    let (names, values): (Vec<String>, Vec<f64>) = parts.into_iter().unzip();
    let labels: Vec<String> =
        names.iter().zip(&values).map(|(name, us)| format!("{name}: {} us", three(*us))).collect();
    (!labels.is_empty())
        .then(|| plot::bars(&title, "time of a mean timestep (us)", &labels, &[(String::new(), values)]))
}

/// Run time against error (`bench pareto`) or energy against time (`map --pareto`), with the front.
pub fn pareto(result: &Value) -> Option<String> {
    let benched = result["name"] == "pareto";
    let all = rows(if benched { &result["rows"] } else { &result["pareto"] });
    let point = |row: &Value| {
        Some(match benched {
            true => {
                let error = 1.0 - number(&row["coincidence"])?;
                (number(&row["us_per_timestep"])?, error, words(&row["variant"]).to_string())
            }
            false => {
                let cores = row["cores"].as_u64().map_or(String::new(), |cores| format!("{cores} cores"));
                (number(&row["step_us"])?, number(&row["energy_uj"])?, cores)
            }
        })
    };
    let mut points: Vec<_> = all.iter().filter_map(|row| Some((point(row)?, row["on_front"] == true))).collect();
    if points.is_empty() {
        return None;
    }
    points.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
    let model = words(&result["model"]);
    let (title, x, y) = match benched {
        true => (
            format!("{model}: run time against error"),
            Axis::log("microseconds a timestep"),
            Axis::linear("1 - coincidence (0: every spike)"),
        ),
        false => (
            format!("Mappings of {model}"),
            Axis::linear("time of a mean step (us)"),
            Axis::linear("energy of a mean step (uJ)"),
        ),
    };
    Some(plot::chart(&title, &x, &y, &plot::front_series(points.into_iter())))
}

/// Causes of disagreement of `nsim agree`, both ways; without them, the coincidence of each layer.
pub fn agreement(result: &Value) -> Option<String> {
    let model = words(&result["model"]);
    let shares = rows(&result["attribution"]);
    if shares.is_empty() {
        fn known(layer: &Value) -> Option<(String, f64)> {
            Some((words(&layer["name"]).to_string(), number(&layer["coincidence"])?))
        }
        let (names, values): (Vec<String>, Vec<f64>) = rows(&result["layers"]).iter().filter_map(known).unzip();
        let title = format!("{model} and {}: spikes that coincide", words(&result["against"]));
        let series = [(String::new(), values)];
        return (!names.is_empty()).then(|| plot::bars(&title, "coincidence (1: all)", &names, &series));
    }
    let causes: Vec<String> = shares.iter().map(|share| words(&share["cause"]).to_string()).collect();
    let each = |pick: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        let both = |share: &Value| Some(pick(number(&share["forward"])?, number(&share["reversed"])?));
        shares.iter().map(|share| both(share).unwrap_or(0.0)).collect()
    };
    let series = [
        ("forward".to_string(), each(&|forward, _| forward)),
        ("reversed".to_string(), each(&|_, reversed| reversed)),
        ("mean".to_string(), each(&|forward, reversed| (forward + reversed) / 2.0)),
    ];
    let title = format!("{model}: causes of differences from the trained network");
    Some(plot::bars(&title, "added disagreement (1 - coincidence)", &causes, &series))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn results_are_drawn_and_what_lacks_its_numbers_is_not() {
        let row = |unit: &str, mw: f64| {
            json!({ "hardware": "loihi", "unit": unit, "static_mw": mw, "dynamic_mw": 1.0, "energy_uj": 5.0,
                    "low": { "energy_uj": 4.0 }, "high": { "energy_uj": 6.0 }, "source": "simulated" })
        };
        let result = json!({
            "model": "m", "target": "t", "rows": [row("x86", 3.0), row("neuron", 2.0), row("total", 5.0)],
            "breakdown_pj_per_timestep": { "synaptic_event": 30.0, "hop": 0.0, "spike": 70.0 },
            "time_us_per_timestep": { "slowest_core": 2.0, "barrier": 1.0, "host": 0.0 },
        });
        // A point of the total row with its value and interval.
        let svg = hardware(&result).unwrap();
        assert!(svg.contains(">(simulated)<") && svg.matches("<circle").count() == 1, "{svg}");
        assert!(svg.contains(">5.00<") && svg.contains("m on t: a timestep"), "{svg}");
        assert_eq!(svg.matches("stroke-width=\"2.00\"").count(), 1, "{svg}");
        let svg = energy(&result).unwrap();
        assert!(svg.contains(">synaptic event<") && !svg.contains(">hop<") && svg.contains("all: 5.00 uJ"));
        let svg = time(&result).unwrap();
        assert!(svg.contains("time of a timestep by part, 3.00 us") && svg.contains("slowest core: 2.00 us"));
        let row = |x: f64, front: bool| json!({ "us_per_timestep": x, "coincidence": 0.9, "variant": "v", "on_front": front });
        let benched = json!({ "name": "pareto", "model": "m", "rows": [row(1.0, true), row(2.0, false)] });
        assert!(pareto(&benched).unwrap().contains("behind it"));
        let mapped =
            json!({ "model": "m", "pareto": [{ "step_us": 1.0, "energy_uj": 2.0, "cores": 3, "on_front": true }] });
        let svg = pareto(&mapped).unwrap();
        assert!(svg.contains("3 cores") && !svg.contains("behind it"));
        let agreed = json!({ "model": "m", "against": "srm", "layers": [{ "name": "hidden", "coincidence": 0.5 }] });
        assert!(agreement(&agreed).unwrap().contains(">hidden<"));
        let caused = json!({ "attribution": [{ "cause": "weights", "forward": 0.1, "reversed": 0.2 }] });
        assert!(agreement(&caused).unwrap().contains(">weights<"));
        for drawn in [hardware, energy, time, pareto, agreement] {
            for nothing in
                [json!({}), json!([]), json!({ "rows": [{}], "pareto": [7], "layers": "x", "attribution": [] })]
            {
                assert!(drawn(&nothing).is_none_or(|svg| !svg.contains("NaN")), "{nothing}");
            }
        }
    }
}
