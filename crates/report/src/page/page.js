// Draws the data of this page. Sections without data are omitted.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  // Decals distinguish bars without colours.
  const { colours } = data;
  const main = document.getElementById("main");
  const nav = document.getElementById("nav");
  const waiting = [];
  // Greatest number of rows of a chart or a list: a browser draws no more in a second.
  const mostRows = 40;
  const firstOf = (list, what) => (list.length > mostRows ? `; the first ${mostRows} of ${number(list.length)} ${what}` : "");

  // ---- small helpers -------------------------------------------------------------------------------------------------
  function element(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key === "class") made.className = value;
      else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
      else if (value !== null && value !== undefined) made.setAttribute(key, value);
    }
    made.append(...children.flat().filter((child) => child !== null && child !== undefined));
    return made;
  }
  // The ends of an axis lie beyond its numbers, and have to stay below 1e308.
  const isNumber = (x) => typeof x === "number" && Math.abs(x) < 1e300;
  // Three digits, with thin spaces between thousands.
  function number(x, digits = 3) {
    if (!isNumber(x)) return "–";
    if (x === 0) return "0";
    const size = Math.abs(x);
    if (Number.isInteger(x) && size < 1e15) return x.toLocaleString("en-US").replaceAll(",", "\u2009");
    if (size >= 1e6 || size < 1e-3) return power(x.toExponential(digits - 1));
    return size >= 100 ? Math.round(x).toLocaleString("en-US").replaceAll(",", "\u2009") : String(Number(x.toPrecision(digits)));
  }
  const power = (text) => { const [value, exponent] = text.split("e"); return `${value} × 10${[...String(Number(exponent))].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("")}`; };
  const plural = (count, one, many = one + "s") => `${number(count)} ${count === 1 ? one : many}`;
  const sum = (list) => list.reduce((a, b) => a + b, 0);
  const spaced = (name) => name.replaceAll("_", " ");
  const escape = (text) => String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);

  function table(head, rows, textColumns = [0]) {
    const kind = (index) => (textColumns.includes(index) ? "text" : null);
    const cell = (name, value, index) => element(name, { class: kind(index), scope: name === "th" ? "col" : null }, String(value));
    return element("div", { class: "scroll" }, element("table", {},
      element("thead", {}, element("tr", {}, head.map((value, index) => cell("th", value, index)))),
      element("tbody", {}, rows.map((row) => element("tr", {}, row.map((value, index) => cell("td", value, index)))))));
  }
  function section(id, title, lead) {
    const made = element("section", { id, "aria-labelledby": id + "-title" }, element("h2", { id: id + "-title" }, title));
    if (lead) made.append(element("p", { class: "lead" }, lead));
    main.append(made);
    nav.append(element("a", { href: "#" + id }, title));
    return made;
  }
  // A chart with a caption and, where given, its numbers as a table.
  function chart(parent, caption, height, option, numbers) {
    const box = element("div", { class: "chart", role: "img", "aria-label": caption });
    box.style.height = height + "px";
    const figure = element("figure", {}, element("figcaption", {}, caption), box);
    if (numbers) figure.append(element("details", {}, element("summary", {}, "These numbers as a table"), numbers));
    parent.append(figure);
    const handle = { draw: null, box, then: [] };
    handle.draw = () => {
      const drawn = echarts.init(box, null, { renderer: "canvas" });
      const base = { color: colours, animation: false, textStyle: { fontFamily: "inherit" }, aria: { enabled: true, label: { enabled: false }, decal: { show: false } } };
      drawn.setOption({ ...base, ...option });
      new ResizeObserver(() => drawn.resize()).observe(box);
      handle.chart = drawn;
      handle.then.forEach((f) => f(drawn));
    };
    waiting.push(handle);
    return handle;
  }
  const zoom = (axes = { xAxisIndex: "all" }) => [
    { type: "inside", ...axes, zoomOnMouseWheel: "ctrl", moveOnMouseWheel: false },
    { type: "slider", ...axes, height: 16, bottom: 4, brushSelect: false },
  ];
  const toolbox = { right: 4, top: 0, itemSize: 13, feature: { dataZoom: { title: { zoom: "zoom", back: "back" } }, restore: { title: "whole" }, saveAsImage: { title: "save as PNG", name: "nsim" } } };
  const axisName = (name, gap = 28) => ({ name, nameLocation: "middle", nameGap: gap });

  // ---- figures of a result -------------------------------------------------------------------------------------------
  const results = data.results;
  const result = results[0] || {};
  const rows = result.rows || [];
  const totalOf = (of) => (of.rows || []).find((row) => row.hardware === of.rows[0].hardware && row.unit === "total");
  const total = totalOf(result);
  // A row of x86 cores names their number.
  const unitName = (row) => (row.unit === "neuron" ? "neuron cores" : row.x86_cores > 1 ? plural(row.x86_cores, "x86 core") : row.unit);
  const interval = (row, key) => (row && row.low && row.high && isNumber(row.low[key]) ? `${number(row.low[key], 2)} to ${number(row.high[key], 2)}` : null);
  // Loihi 2's constants are modelled, so an interval bounds them alone.
  const spread = isNumber(result.level) ? `${100 * result.level} %` : "model's bounds";
  const timesteps = result.timesteps || 0;

  function header() {
    const head = document.getElementById("header");
    document.title = data.title;
    head.append(element("h1", {}, data.title));
    if (results.length > 1) {
      head.append(element("p", { class: "lead" }, "Two results side by side. A ratio is the second over the first."));
      return;
    }
    const of = result.copies > 1 ? `one of ${number(result.copies)} copies` : "one copy";
    const words = [of, result.deployment, result.mode, plural(result.samples, "sample"), plural(timesteps, "timestep"), (result.input || []).join(", ")];
    head.append(element("p", { class: "lead" }, words.filter(Boolean).join(" · ")));
    const cards = [];
    const card = (value, unit, words) => cards.push(element("div", { class: "card" }, element("b", {}, `${value} ${unit}`), element("span", {}, words)));
    if (total) {
      const within = (key) => (interval(total, key) ? ` (${spread}: ${interval(total, key)})` : "");
      card(number(total.energy_uj, 2), "µJ", "energy of a timestep" + within("energy_uj"));
      card(number(total.latency_us, 2), "µs", "time of a timestep" + within("latency_us"));
      card(number(total.total_mw, 2), "mW", "power" + within("total_mw"));
    }
    if (result.cores_used) card(number(result.cores_used), result.cores_used === 1 ? "core" : "cores", `${plural(result.chips_used, "chip")}, ${plural(result.x86_cores, "x86 core")}${isNumber((result.host || {}).x86_share) ? `, ${number(100 * result.host.x86_share, 2)} % of a step for input` : ""}`);
    if (result.populations && result.populations.length) {
      const spikes = sum(result.populations.map((row) => row.spikes));
      card(number(timesteps ? spikes / timesteps : 0), "", `spikes of compartments a timestep, ${number(sum(result.populations.map((row) => row.compartments)))} compartments`);
    }
    if (data.confusion) {
      const right = sum(data.confusion.counts.map((row, index) => row[index]));
      const all = sum(data.confusion.counts.flat());
      card(`${number((100 * right) / Math.max(all, 1))} %`, "", `right, of ${plural(all, "sample")} with a label`);
    } else if (isNumber(result.accuracy)) card(`${number(100 * result.accuracy)} %`, "", "accuracy");
    head.append(element("div", { class: "cards" }, cards));
    warnings(head, result);
  }
  function warnings(parent, of) {
    if (!of.warnings || !of.warnings.length) return;
    const line = (warning) => element("li", {}, element("b", {}, warning.population ? `${warning.population}: ` : ""), warning.message);
    const more = of.warnings.length > mostRows ? element("li", {}, `${number(of.warnings.length - mostRows)} more, which nsim run prints`) : null;
    parent.append(element("div", { class: "warnings", role: "note" }, element("b", {}, plural(of.warnings.length, "thing") + " to check"), element("ul", {}, of.warnings.slice(0, mostRows).map(line), more)));
  }

  // ---- network -------------------------------------------------------------------------------------------------------
  function levels(network) {
    // Longest path from an input; projections back to an earlier level do not count.
    const level = Object.fromEntries(network.populations.map((population) => [population.name, 0]));
    for (let round = 0; round < network.populations.length; round++) {
      let moved = false;
      for (const { from, to } of network.projections) {
        if (from !== to && level[to] < level[from] + 1 && level[from] + 1 < network.populations.length) { level[to] = level[from] + 1; moved = true; }
      }
      if (!moved) break;
    }
    return level;
  }
  // Text on the drawn part of a large network.
  function drawnOf(network) {
    const [populations, projections] = [network.populations.length, network.projections.length];
    const cut = network.populations_in_all > populations || network.projections_in_all > projections;
    return cut ? ` The chart has ${populations} of ${plural(network.populations_in_all, "population")}, the first of the model and its output, and ${projections} of ${plural(network.projections_in_all, "projection")}.` : "";
  }
  function networkSection() {
    const network = data.network;
    if (!network) return;
    const part = section("network", "Network", "Choose a population or a projection to see its parameters. The size of a circle is the number of units, its colour the spike rate of a unit." + drawnOf(network));
    const counts = new Map([...(result.populations || []), ...(result.inputs || [])].map((row) => [row.name, row]));
    const rate = (name) => {
      const row = counts.get(name);
      return row ? row.spikes / Math.max((row.compartments || row.channels) * timesteps, 1) : 0;
    };
    const level = levels(network);
    const byLevel = new Map();
    network.populations.forEach((population) => byLevel.set(level[population.name], [...(byLevel.get(level[population.name]) || []), population.name]));
    const deepest = Math.max(...byLevel.keys(), 1);
    const tallest = Math.max(...[...byLevel.values()].map((names) => names.length));
    const highest = Math.max(...network.populations.map((population) => rate(population.name)), 1e-9);
    // From nearly white to blue, as the legend.
    const shade = (part) => { const [low, high] = [[238, 243, 247], [0, 114, 178]]; return `rgb(${low.map((x, at) => Math.round(x + (high[at] - x) * part)).join(",")})`; };
    const nodes = network.populations.map((population) => {
      const beside = byLevel.get(level[population.name]);
      return {
        name: population.name, rate: rate(population.name),
        value: [level[population.name], (beside.indexOf(population.name) + 1) / (beside.length + 1)],
        symbolSize: 20 + 6 * Math.log10(Math.max(population.units, 1)),
        symbol: population.kind === "input" ? "rect" : "circle",
        itemStyle: { color: shade(rate(population.name) / highest), borderColor: "#333", borderWidth: population.name === network.output ? 3.5 : 1 },
      };
    });
    const links = network.projections.map((projection, index) => ({
      source: projection.from, target: projection.to, value: projection.synapses, index,
      lineStyle: { width: 0.8 + Math.log10(Math.max(projection.synapses, 1)) / 2, curveness: projection.from === projection.to ? 0.6 : level[projection.to] > level[projection.from] + 1 ? 0.25 : level[projection.to] <= level[projection.from] ? 0.35 : 0 },
    }));
    const columns = element("div", { class: "columns" });
    const left = element("div");
    const detail = element("div", { "aria-live": "polite" });
    columns.append(left, detail);
    part.append(columns);
    const drawn = chart(left, `Populations (squares are inputs, a thick rim is the output) and projections; a unit of the darkest spikes in ${number(100 * highest)} % of the timesteps`, Math.max(220, Math.min(460, 95 * tallest + 70)), {
      tooltip: { formatter: (at) => at.dataType === "edge" ? `${escape(at.data.source)} → ${escape(at.data.target)}<br>${number(at.data.value)} synapses` : `${escape(at.name)}<br>a unit spikes in ${number(100 * at.data.rate)} % of the timesteps` },
      grid: { left: 50, right: 50, top: 24, bottom: 30 },
      xAxis: { type: "value", show: false, min: -0.15, max: deepest + 0.15 }, yAxis: { type: "value", show: false, inverse: true, min: 0, max: 1 },
      dataZoom: [{ type: "inside", xAxisIndex: 0, zoomOnMouseWheel: "ctrl", filterMode: "none" }],
      series: [{ type: "graph", coordinateSystem: "cartesian2d", data: nodes, links, edgeSymbol: ["none", "arrow"], edgeSymbolSize: 8, label: { show: true, position: "bottom", color: "#222" }, lineStyle: { color: "#888", opacity: 0.85 }, emphasis: { focus: "adjacency" } }],
    });
    const choices = element("div", { class: "choices", role: "group", "aria-label": "Populations and projections" });
    const buttons = [];
    function choose(what, index) {
      buttons.forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.what === what && Number(button.dataset.index) === index)));
      detail.replaceChildren(what === "population" ? population(index) : projection(index));
    }
    function add(what, index, label) {
      const button = element("button", { type: "button", "data-what": what, "data-index": index, "aria-pressed": "false", onclick: () => choose(what, index) }, label);
      buttons.push(button);
      choices.append(button);
    }
    network.populations.forEach((population, index) => add("population", index, population.name));
    network.projections.forEach((projection, index) => add("projection", index, projection.name));
    left.append(choices);
    drawn.then.push((graph) => graph.on("click", (at) => at.dataType === "edge" ? choose("projection", at.data.index) : choose("population", network.populations.findIndex((population) => population.name === at.name))));
    function population(index) {
      const of = network.populations[index];
      const row = counts.get(of.name) || {};
      const lines = [["shape", of.shape], ["units", number(of.units)], ["kind", of.kind]];
      for (const [name, range] of Object.entries(of.parameters || {})) if (range) lines.push([spaced(name), range[0] === range[1] ? number(range[0]) : `${number(range[0])} to ${number(range[1])}`]);
      if (isNumber(row.spikes)) lines.push(["spikes", number(row.spikes)], ["a unit spikes in", `${number(100 * rate(of.name))} % of timesteps`]);
      if (isNumber(row.silent)) lines.push(["never fired", `${number(row.silent)} of ${number(row.compartments)}`], ["clipped, wrapped", `${number(row.clipped)}, ${number(row.wrapped)}`]);
      const notes = network.notes.filter((note) => note.entity === of.name).map((note) => element("p", { class: "soft" }, note.message));
      return element("div", {}, element("h3", {}, of.name), table(["", "value"], lines, [0, 1]), notes);
    }
    function projection(index) {
      const of = network.projections[index];
      const lines = [["kind", of.kind], ["synapses", number(of.synapses)], ["delay field", number(of.delay)], ["weight exponent", number(of.weight_exponent)], ["weight bits", number(of.weight_bits)]];
      if (of.rounded) lines.push(["weights that rounding changed", `${number(of.rounded.changed)} of ${number(of.rounded.weights)}`], ["greatest change", `${number(100 * of.rounded.worst_share)} % of the greatest weight`]);
      const made = element("div", {}, element("h3", {}, of.name), table(["", "value"], lines, [0, 1]));
      if (of.weights) {
        const { low, width, counts } = of.weights;
        const bars = chart(made, "Weights that are stored", 190, {
          tooltip: { trigger: "axis" }, grid: { left: 52, right: 10, top: 10, bottom: 36 },
          xAxis: { type: "category", data: counts.map((_, at) => low + at * width), ...axisName("weight mantissa", 24) }, yAxis: { type: "value", name: "" },
          series: [{ type: "bar", data: counts, barCategoryGap: "8%", name: "weights" }],
        });
        setTimeout(bars.draw, 0);
        waiting.splice(waiting.indexOf(bars), 1);
      }
      network.notes.filter((note) => note.entity === of.name).forEach((note) => made.append(element("p", { class: "soft" }, note.message)));
      return made;
    }
    const first = network.populations.findIndex((population) => population.kind !== "input");
    choose("population", Math.max(first, 0));
  }

  // ---- fit -----------------------------------------------------------------------------------------------------------
  function fitSection() {
    const fit = data.fit;
    if (!fit) return;
    const resources = ["compartments", "axons_in", "axons_out", "synapse_words"];
    const at = Object.fromEntries(fit.columns.map((name, index) => [name, index]));
    const side = Math.ceil(Math.sqrt(Math.max(fit.mesh.cores_per_tile, 1)));
    const part = section("fit", "Fit onto cores", `${plural(fit.cores.length, "core")} on ${fit.target}. A small square is a core; four cores and a router form a tile. Lines are links; wider and darker links carry more messages. Ctrl and wheel zooms, dragging moves.`);
    const share = (core, name) => core[at[name]] / Math.max(fit.limits[resources.indexOf(name)], 1);
    const fullest = (core) => Math.max(...resources.map((name) => share(core, name)));
    const spent = new Map((result.cores || []).map((row) => [row.core, row]));
    const populations = new Map(data.network ? data.network.populations.map((population) => [population.index, population.name]) : []);
    const views = {
      "fullest resource (%)": (core) => 100 * fullest(core),
      ...Object.fromEntries(resources.map((name) => [`${spaced(name)} (%)`, (core) => 100 * share(core, name)])),
      "energy of events (nJ)": (core) => (spent.get(core[0]) ? spent.get(core[0]).energy_pj / 1e3 : 0),
      "busy (µs)": (core) => (spent.get(core[0]) ? spent.get(core[0]).busy_us : 0),
      "timesteps in which it was the slowest": (core) => (spent.get(core[0]) ? spent.get(core[0]).slowest_steps : 0),
      "synaptic events": (core) => (spent.get(core[0]) ? spent.get(core[0]).synaptic_events : 0),
      population: (core) => core[at.population],
    };
    const select = element("select", { id: "fit-view" }, Object.keys(views).map((name) => element("option", {}, name)));
    part.append(element("div", { class: "choices" }, element("label", { for: "fit-view" }, "Colour cores by "), select));
    const place = (core) => {
      const within = core[at["core of tile"]];
      return [core[at.x] + 0.1 + (0.7 * (within % side)) / side, core[at.y] + 0.1 + (0.7 * Math.floor(within / side)) / side];
    };
    const xs = fit.cores.map((core) => core[at.x]).concat(fit.links.flatMap((link) => [link[0], link[2]]));
    const ys = fit.cores.map((core) => core[at.y]).concat(fit.links.flatMap((link) => [link[1], link[3]]));
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs) + 1, Math.min(...ys), Math.max(...ys) + 1];
    const busiest = Math.max(...fit.links.map((link) => link[4]), 0);
    const chips = new Map();
    fit.cores.forEach((core) => chips.set(core[at.chip], [Math.floor(core[at.x] / fit.mesh.width), Math.floor(core[at.y] / fit.mesh.height)]));
    const tooltip = (core) => {
      const row = spent.get(core[0]);
      const lines = [`core ${core[0]} on chip ${core[at.chip]}, tile ${core[at.x]}, ${core[at.y]}`, populations.has(core[at.population]) ? `mostly ${escape(populations.get(core[at.population]))}` : null];
      resources.forEach((name, index) => lines.push(`${spaced(name)}: ${number(core[at[name]])} of ${number(fit.limits[index])}`));
      if (row) lines.push(`events: ${number(row.synaptic_events)}, spikes ${number(row.spikes)}`, `energy ${number(row.energy_pj / 1e3)} nJ, busy ${number(row.busy_us)} µs, slowest in ${number(row.slowest_steps)} steps`);
      return lines.filter(Boolean).join("<br>");
    };
    const width = Math.min(main.clientWidth || 1100, 1140) - 170;
    // A tile takes at most 110 pixels.
    const tile = Math.min(110, width / (right - left), 620 / (bottom - top));
    const height = tile * (bottom - top + 0.4) + 68;
    function option(view) {
      const value = views[view];
      const values = fit.cores.map(value);
      const most = Math.max(...values, 1e-9);
      const byPopulation = view === "population";
      const visual = byPopulation
        ? { type: "piecewise", categories: [...populations.keys()], dimension: 2, seriesIndex: 2, right: 0, top: 30, orient: "vertical", formatter: (index) => populations.get(Number(index)), inRange: { color: [...populations.keys()].map((_, index) => colours[index % colours.length]) } }
        : { type: "continuous", min: 0, max: view.endsWith("(%)") ? 100 : most, dimension: 2, seriesIndex: 2, right: 6, top: 30, itemHeight: 90, calculable: false, text: [view.endsWith("(%)") ? "100" : number(most), "0"], inRange: { color: ["#f7fbff", "#9ecae1", "#4292c6", "#08519c", "#08306b"] } };
      return {
        tooltip: { confine: true, formatter: (hit) => (hit.seriesIndex === 2 ? tooltip(fit.cores[hit.dataIndex]) : hit.seriesIndex === 1 ? `link ${hit.data[0]}, ${hit.data[1]} to ${hit.data[2]}, ${hit.data[3]}<br>${number(hit.data[4])} messages a step, both ways` : `chip ${hit.data[2]}`) },
        toolbox,
        visualMap: visual,
        grid: { left: 46, width: tile * (right - left + 0.4), top: 28, bottom: 40 },
        xAxis: { min: left - 0.3, max: right + 0.1, axisLine: { show: false }, axisTick: { show: false }, axisLabel: { formatter: (x) => (Number.isInteger(x) ? x : "") }, splitLine: { show: false }, minInterval: 1, ...axisName("tile, from the west", 22) },
        yAxis: { min: top - 0.3, max: bottom + 0.1, inverse: true, axisLine: { show: false }, axisTick: { show: false }, name: "tile, from the north", nameLocation: "middle", nameGap: 30, axisLabel: { formatter: (y) => (Number.isInteger(y) ? y : "") }, splitLine: { show: false }, minInterval: 1 },
        dataZoom: [{ type: "inside", xAxisIndex: 0, zoomOnMouseWheel: "ctrl", filterMode: "none" }, { type: "inside", yAxisIndex: 0, zoomOnMouseWheel: "ctrl", filterMode: "none" }],
        series: [
          { type: "custom", name: "chips", silent: true, clip: true, data: [...chips].map(([chip, [x, y]]) => [x, y, chip]), renderItem: (_, api) => {
            const [x0, y0] = api.coord([api.value(0) * fit.mesh.width - 0.06, api.value(1) * fit.mesh.height - 0.06]);
            const [x1, y1] = api.coord([(api.value(0) + 1) * fit.mesh.width - 0.14, (api.value(1) + 1) * fit.mesh.height - 0.14]);
            return { type: "rect", shape: { x: x0, y: y0, width: x1 - x0, height: y1 - y0 }, style: { fill: "none", stroke: "#888", lineDash: [4, 3] } };
          } },
          { type: "custom", name: "links", progressive: 0, data: fit.links, dimensions: ["x", "y", "to_x", "to_y", "load"], encode: { x: [0, 2], y: [1, 3] }, renderItem: (_, api) => {
            const [x0, y0] = api.coord([api.value(0) + 0.45, api.value(1) + 0.45]);
            const [x1, y1] = api.coord([api.value(2) + 0.45, api.value(3) + 0.45]);
            const part = busiest > 0 ? api.value(4) / busiest : 0;
            return { type: "line", shape: { x1: x0, y1: y0, x2: x1, y2: y1 }, style: { stroke: part > 0.66 ? "#b2182b" : part > 0.33 ? "#666" : "#aaa", lineWidth: 0.6 + 6 * part } };
          } },
          { type: "custom", name: "cores", progressive: 0, data: fit.cores.map((core, index) => [...place(core), values[index]]), renderItem: (_, api) => {
            const [x0, y0] = api.coord([api.value(0), api.value(1)]);
            const [x1, y1] = api.coord([api.value(0) + 0.62 / side, api.value(1) + 0.62 / side]);
            return { type: "rect", shape: { x: x0, y: y0, width: Math.max(x1 - x0, 1.5), height: Math.max(y1 - y0, 1.5) }, style: { fill: api.visual("color"), stroke: "#333", lineWidth: x1 - x0 > 5 ? 0.7 : 0 } };
          } },
        ],
      };
    }
    const few = fit.cores.slice(0, 500);
    const numbers = table(["core", "chip", "tile", ...resources.map(spaced), "fullest (%)"], few.map((core) => [core[0], core[at.chip], `${core[at.x]}, ${core[at.y]}`, ...resources.map((name) => number(core[at[name]])), number(100 * fullest(core))]));
    const shown = fit.cores.length > few.length ? `; the table shows the first ${few.length}` : "";
    const drawn = chart(part, `Cores by place${busiest > 0 ? `; the busiest link carries ${number(busiest)} messages a step` : ""}${shown}`, height, option(select.value), numbers);
    select.addEventListener("change", () => drawn.chart && drawn.chart.setOption(option(select.value), { notMerge: true }));
  }

  // ---- one sample ----------------------------------------------------------------------------------------------------
  const sample = data.sample;
  const className = (index) => (index === null || index === undefined ? "none" : (data.network && data.network.classes[index]) || String(index));
  function spikesSection() {
    if (!sample) return;
    const cutLength = sample.steps < sample.steps_of_sample ? ` Only its first ${number(sample.steps)} of ${number(sample.steps_of_sample)} timesteps are shown.` : "";
    const part = section("spikes", "Spikes", `The first sample, ${plural(sample.steps, "timestep")}.${cutLength}${drawnOf(data.network)}`);
    const shown = sample.rasters.filter((raster) => raster.units > 0);
    const outputName = data.network.output;
    const heights = shown.map((raster) => Math.max(46, Math.min(170, 30 + 2.2 * Math.min(raster.units, 400 / 1))));
    const output = shown.find((raster) => raster.name === outputName);
    const counted = sample.decides && sample.by_spikes && output && output.every === 1 && output.units <= 24;
    const all = heights.concat(counted ? [150] : []);
    let top = 34;
    const grids = all.map((height) => { const grid = { left: 92, right: 24, top, height }; top += height + 26; return grid; });
    const last = all.length - 1;
    const xAxis = all.map((_, index) => ({ gridIndex: index, type: "value", min: 0, max: sample.steps, axisLabel: { show: index === last }, axisTick: { show: index === last }, splitLine: { show: false }, ...(index === last ? axisName("timestep", 24) : {}) }));
    const yAxis = shown.map((raster, index) => ({ gridIndex: index, type: "value", min: -0.5, max: raster.units - 0.5, inverse: true, axisLabel: { show: true, showMinLabel: false, formatter: (y) => (Number.isInteger(y) ? y : "") }, splitNumber: 2, minInterval: 1, splitLine: { show: false }, name: raster.name, nameLocation: "middle", nameGap: 44, nameRotate: raster.name.length > 9 || heights[index] < 60 ? 0 : 90, nameTextStyle: { width: 84, overflow: "truncate" } }));
    const series = shown.map((raster, index) => ({
      type: "scatter", name: raster.name, xAxisIndex: index, yAxisIndex: index, symbol: "rect", symbolSize: raster.units <= 12 ? [2, 9] : 2.4, large: raster.step.length > 3000, largeThreshold: 3000, progressive: 0, itemStyle: { color: raster.name === outputName ? colours[1] : raster.name === shown[0].name ? "#555" : colours[2 + (index % 4)] },
      data: raster.step.map((step, at) => [step, raster.unit[at]]),
    }));
    if (counted) {
      yAxis.push({ gridIndex: last, type: "value", name: "spikes so far", nameLocation: "middle", nameGap: 40, minInterval: 1 });
      for (let unit = 0; unit < output.units; unit++) {
        const points = [[0, 0]];
        let count = 0;
        output.unit.forEach((of, at) => { if (of === unit) { points.push([output.step[at], count], [output.step[at], ++count]); } });
        points.push([sample.steps, count]);
        const decided = unit === 0 && sample.decided_at !== null ? { markLine: { silent: true, symbol: "none", label: { formatter: "decided", position: "insideEndTop" }, lineStyle: { color: "#000", type: "dotted" }, data: [{ xAxis: sample.decided_at }] } } : {};
        series.push({ type: "line", name: `output ${className(unit)}`, xAxisIndex: last, yAxisIndex: last, symbol: "none", lineStyle: { width: unit === sample.predicted ? 3 : 1.5, type: ["solid", "dashed", "dotted"][unit % 3] }, itemStyle: { color: colours[unit % colours.length] }, data: points, ...decided });
      }
    }
    const reduced = shown.filter((raster) => raster.every > 1 || raster.cut).map((raster) => `${raster.name}: ${raster.every > 1 ? `one unit in ${raster.every}` : "all units"}${raster.cut ? ", the first spikes only" : ""}`);
    const values = shown.filter((raster) => raster.values).map((raster) => raster.name);
    chart(part, `A mark is a spike${values.length ? `, of ${values.join(", ")} a message with a value` : ""}${counted ? "; below, the spikes of each output so far" : ""}.${reduced.length ? ` Reduced: ${reduced.join("; ")}.` : ""}`, top + 40, {
      tooltip: { trigger: "item", formatter: (at) => (at.seriesType === "scatter" ? `${escape(at.seriesName)}, unit ${at.value[1]}<br>timestep ${at.value[0]}` : `${escape(at.seriesName)}: ${at.value[1]} at ${at.value[0]}`) },
      toolbox, legend: counted ? { top: 4, left: 92, data: series.filter((one) => one.type === "line").map((one) => one.name) } : undefined,
      grid: grids, xAxis, yAxis, series, dataZoom: zoom(),
    }, table(["population", "units", "spikes shown"], shown.map((raster) => [raster.name, number(raster.units), number(raster.step.length)])));
  }
  function potentialsSection() {
    if (!sample || !sample.potentials.length) return;
    const group = sample.steps_a_point;
    const messages = sample.of_messages;
    const words = messages ? "The values that the outputs and the most active compartments of each population sent in the first sample; 0 where none was sent." : "The voltage of the outputs and of the most active compartments of each population in the first sample, after the update and the reset of each timestep; a dashed line is a threshold.";
    const part = section("potentials", messages ? "Messages" : "Potentials", `${words}${group > 1 ? ` A point is the largest of ${group} timesteps.` : ""}`);
    const height = 84;
    let top = 26;
    const grids = sample.potentials.map(() => { const grid = { left: 120, right: 24, top, height: height - 18 }; top += height; return grid; });
    const last = grids.length - 1;
    chart(part, messages ? "Values over timesteps" : "Voltage over timesteps", top + 56, {
      tooltip: { trigger: "axis", axisPointer: { type: "line" }, valueFormatter: (x) => number(x) }, toolbox, axisPointer: { link: [{ xAxisIndex: "all" }] },
      grid: grids, dataZoom: zoom(),
      xAxis: grids.map((_, index) => ({ gridIndex: index, type: "value", min: 0, max: sample.steps, axisLabel: { show: index === last }, axisTick: { show: index === last }, splitLine: { show: false }, ...(index === last ? axisName("timestep", 24) : {}) })),
      yAxis: sample.potentials.map((of, index) => ({ gridIndex: index, type: "value", splitNumber: 2, axisLabel: { formatter: (x) => (Math.abs(x) >= 1000 ? `${number(x / 1000)}k` : x) }, name: of.name, nameLocation: "middle", nameGap: 52, nameRotate: 0, nameTextStyle: { align: "right", width: 66, overflow: "truncate" }, max: (range) => Math.max(range.max, of.threshold * 1.05) })),
      series: sample.potentials.map((of, index) => ({ type: "line", name: of.name, xAxisIndex: index, yAxisIndex: index, symbol: "none", lineStyle: { width: 1.2 }, itemStyle: { color: colours[index % 6] }, data: of.largest.map((v, at) => [at * group, v]), markLine: { silent: true, symbol: "none", label: { show: false }, lineStyle: { type: "dashed", color: "#333" }, data: of.threshold === null ? [] : [{ yAxis: of.threshold }] } })),
    });
  }
  function stepsSection() {
    if (!sample) return;
    const group = sample.steps_a_point;
    const pick = (prefix) => Object.entries(sample.curves).filter(([name]) => name.startsWith(prefix)).map(([name, curve]) => [spaced(name.slice(prefix.length)), curve]).filter(([, curve]) => curve.some((x) => x > 0));
    const times = pick("time_us."), energies = pick("energy_pj.");
    const part = section("steps", "Power and time over timesteps", `The first sample, at the chip's greatest speed, all copies together.${group > 1 ? ` A point is the mean of ${group} timesteps.` : ""}`);
    const length = (Object.values(sample.curves)[0] || []).length;
    const steps = Array.from({ length }, (_, at) => at * group);
    const duration = steps.map((_, at) => sum(times.map(([, curve]) => curve[at])));
    const stacked = (caption, unit, parts, scale) => chart(part, caption, 290, {
      tooltip: { trigger: "axis", valueFormatter: (x) => `${number(x)} ${unit}` }, toolbox, legend: { top: 0, left: 60, right: 110, type: "scroll" },
      grid: { left: 66, right: 20, top: 34, bottom: 58 }, dataZoom: zoom({ xAxisIndex: 0 }),
      xAxis: { type: "category", data: steps, boundaryGap: false, ...axisName("timestep", 22) }, yAxis: { type: "value", ...axisName(unit, 48) },
      series: parts.map(([name, curve]) => ({ type: "line", name, stack: "all", areaStyle: { opacity: 0.85 }, symbol: "none", lineStyle: { width: 0.5 }, data: curve.map((x, at) => scale(x, at)) })),
    }, table(["part", `mean (${unit})`, `greatest (${unit})`], parts.map(([name, curve]) => { const all = curve.map((x, at) => scale(x, at)); return [name, number(sum(all) / Math.max(all.length, 1)), number(all.reduce((a, b) => Math.max(a, b), 0))]; })));
    if (times.length) stacked("Time of a timestep, by part; parts are sequential", "µs", times, (x) => x);
    // Picojoules a microsecond are microwatts.
    if (energies.length && times.length) stacked("Power of events, by part (energy of the events of a timestep over its time; static power is not included)", "mW", energies, (x, at) => (duration[at] > 0 ? x / duration[at] / 1e3 : 0));
    if (energies.length) stacked("Energy of the events of a timestep, by part", "nJ", energies, (x) => x / 1e3);
  }

  // ---- breakdowns ----------------------------------------------------------------------------------------------------
  function parts(caption, parent, entries, unit, total) {
    const known = entries.filter(([, x]) => isNumber(x) && x > 0).sort((a, b) => b[1] - a[1]);
    if (!known.length) return;
    const all = sum(known.map(([, x]) => x));
    chart(parent, `${caption}: ${number(total ?? all)} ${unit}`, 60 + 30 * known.length, {
      tooltip: { valueFormatter: (x) => `${number(x)} ${unit}` }, aria: { enabled: true, label: { enabled: false }, decal: { show: true } }, grid: { left: 138, right: 74, top: 6, bottom: 40 },
      xAxis: { type: "value", ...axisName(unit, 24) }, yAxis: { type: "category", inverse: true, data: known.map(([name]) => name), axisLabel: { width: 128, overflow: "truncate" } },
      series: [{ type: "bar", colorBy: "data", data: known.map(([, x]) => x), label: { show: true, position: "right", formatter: (at) => `${number((100 * at.value) / all, 2)} %` } }],
    }, table(["part", unit, "share (%)"], known.map(([name, x]) => [name, number(x), number((100 * x) / all)])));
  }
  function goesSection() {
    if (!result.breakdown_pj_per_timestep && !result.time_us_per_timestep) return;
    const part = section("goes", "Time and energy by part", `A mean timestep, constants ${result.preset}.${result.copies > 1 ? " Energies are of one copy." : ""}`);
    const halves = element("div", { class: "halves" });
    part.append(halves);
    const [one, two] = [element("div"), element("div")];
    halves.append(one, two);
    const times = Object.entries(result.time_us_per_timestep || {}).map(([name, x]) => [spaced(name), x]);
    parts("Time", one, times, "µs");
    const units = rows.filter((row) => row.hardware === rows[0].hardware && row.unit !== "total").map((row) => [unitName(row), row.energy_uj]);
    parts("Energy, static and dynamic", two, units, "µJ");
    parts("Energy of events", one, Object.entries(result.breakdown_pj_per_timestep || {}).map(([name, x]) => [spaced(name), x / 1e3]), "nJ");
    const slow = (result.cores || []).filter((row) => row.slowest_steps > 0).sort((a, b) => b.slowest_steps - a.slowest_steps).slice(0, 8);
    parts("Cores by the number of timesteps in which they were the slowest", two, slow.map((row) => [`core ${row.core}, chip ${row.chip}`, row.slowest_steps]), "timesteps");
  }
  // Text on the class of the first sample, and on the accuracy.
  function decision() {
    const said = sample && sample.decides ? `The network assigns class ${className(sample.predicted)} to the first sample${sample.label === null ? "" : `, whose class is ${className(sample.label)}`}${sample.decided_at === null ? "" : `, decided after timestep ${sample.decided_at}`}.` : "";
    return `${said}${isNumber(result.accuracy) ? ` It is right in ${number(100 * result.accuracy)} % of ${plural(result.samples, "sample")}.` : ""}`;
  }
  function hardwareSection() {
    const list = rows.filter((row) => row.unit === "total" || row.hardware !== rows[0].hardware);
    if (list.length < 1 || !total) return;
    const part = section("hardware", "Energy and time compared with other hardware", `${decision()} Figures are of a timestep of one copy.`.trim());
    part.append(table(["hardware", "static (mW)", "dynamic (mW)", "time (µs)", "energy (µJ)", "energy-delay (nJ s)", "source"], rows.map((row) => [row.unit === "total" || row.hardware !== rows[0].hardware ? row.hardware : `${row.hardware} ${unitName(row)}`, number(row.static_mw), number(row.dynamic_mw), number(row.latency_us), number(row.energy_uj), number(row.edp_pjs / 1e3), row.power_source && row.power_source !== row.source ? `${row.source}, power ${row.power_source}` : row.source]), [0, 6]));
    part.append(element("p", { class: "lead" }, `Axes are logarithmic. A bar ${isNumber(result.level) ? `is an ${spread} interval, from the errors of predictions of published measurements` : "spans the bounds of modelled constants"}.`));
    const halves = element("div", { class: "halves" });
    part.append(halves);
    const nameOf = (row) => `${row.hardware} (${row.source})`;
    for (const [key, unit, words] of [["energy_uj", "µJ", "Energy"], ["latency_us", "µs", "Time"]]) {
      const box = element("div");
      halves.append(box);
      const known = list.filter((row) => isNumber(row[key]) && row[key] > 0);
      const bars = known.map((row, index) => (row.low && row.high && row.low[key] > 0 ? [row.low[key], row.high[key], index] : null)).filter(Boolean);
      chart(box, `${words} of a timestep (${unit})`, 90 + 34 * known.length, {
        tooltip: { formatter: (at) => { const row = known[at.seriesIndex === 0 ? at.data[2] : at.dataIndex]; return `${escape(nameOf(row))}<br>${number(row[key])} ${unit}${interval(row, key) ? `<br>${spread}: ${interval(row, key)}` : ""}`; } },
        grid: { left: 205, right: 20, top: 8, bottom: 42 },
        xAxis: { type: "log", ...axisName(`${unit}, logarithmic`, 26), axisLabel: { formatter: (x) => number(x) }, minorSplitLine: { show: true, lineStyle: { color: "#f0f0f0" } } },
        yAxis: { type: "category", inverse: true, data: known.map(nameOf), axisLabel: { width: 195, overflow: "break", lineHeight: 13 } },
        series: [
          { type: "custom", data: bars, encode: { x: [0, 1], y: 2 }, renderItem: (_, api) => {
            const [x0, y] = api.coord([api.value(0), api.value(2)]);
            const [x1] = api.coord([api.value(1), api.value(2)]);
            const line = (x1_, y1, x2, y2) => ({ type: "line", shape: { x1: x1_, y1, x2, y2 }, style: { stroke: "#333", lineWidth: 2 } });
            return { type: "group", children: [line(x0, y, x1, y), line(x0, y - 6, x0, y + 6), line(x1, y - 6, x1, y + 6)] };
          } },
          { type: "scatter", symbolSize: 12, data: known.map((row, index) => ({ value: [row[key], index], symbol: row.hardware === rows[0].hardware ? "circle" : "diamond", itemStyle: { color: row.hardware === rows[0].hardware ? colours[0] : colours[1] } })) },
        ],
      });
    }
  }

  // ---- agreement and classes -----------------------------------------------------------------------------------------
  function agreementSection() {
    const agreement = data.agreement;
    if (!agreement) return;
    const classes = isNumber(agreement.class_agreement) ? ` Classes agree in ${number(100 * agreement.class_agreement)} %.` : "";
    const part = section("agreement", "Agreement with the trained network", `The integers on cores compared with the trained network, ${plural(agreement.samples, "sample")}.${classes}`);
    const layers = agreement.layers || [];
    const spiking = layers.filter((layer) => layer.spikes_a + layer.spikes_b > 0);
    const compared = spiking.slice(0, mostRows);
    chart(part, `Share of spikes that coincide, by layer (1 is every spike)${firstOf(spiking, "layers")}`, 60 + 34 * Math.max(compared.length, 1), {
      tooltip: { valueFormatter: (x) => number(x) }, grid: { left: 130, right: 60, top: 6, bottom: 40 },
      xAxis: { type: "value", min: 0, max: 1, ...axisName("coincidence", 24) }, yAxis: { type: "category", inverse: true, data: compared.map((layer) => layer.layer ?? layer.name) },
      series: [{ type: "bar", data: compared.map((layer) => layer.coincidence), label: { show: true, position: "right", formatter: (at) => number(at.value) } }],
    });
    part.append(table(["layer", "spikes trained", "spikes on cores", "coincidence", "first difference"], layers.map((layer) => { const first = layer.first_divergence; return [layer.layer ?? layer.name, number(layer.spikes_a), number(layer.spikes_b), layer.spikes_a + layer.spikes_b > 0 ? number(layer.coincidence) : "nothing to compare", first ? `sample ${first.sample}, timestep ${first.timestep}, neuron ${first.neuron}` : "none"]; }), [0, 4]));
  }
  function learningSection() {
    if (!data.learning) return;
    const part = section("learning", "Learning", "What each rule changes in the first sample, from the weights of the model.");
    for (const rule of data.learning) {
      const words = [rule.changes.join("; ") || "PES", `epochs of ${plural(rule.epoch, "timestep")}`, rule.semantics, `${number(rule.changed)} of ${plural(rule.synapses, "weight")} changed`];
      part.append(element("h3", {}, rule.name), element("p", {}, words.join(" · ")));
      const box = element("div", { class: "scroll" });
      box.append(document.importNode(new DOMParser().parseFromString(rule.picture, "image/svg+xml").documentElement, true));
      part.append(box);
    }
  }
  function classesSection() {
    const confusion = data.confusion;
    if (!confusion) return;
    const { classes, counts } = confusion;
    const columns = classes.concat(["none"]);
    const none = counts.some((row) => row[classes.length] > 0);
    const shown = none ? columns : classes;
    const part = section("classes", "Classes", `Samples by their class and by the class from the network, ${number(sum(counts.flat()))} in all.`);
    const most = Math.max(...counts.flat(), 1);
    const points = counts.flatMap((row, label) => row.slice(0, shown.length).map((count, said) => [said, label, count]));
    const side = Math.max(150, Math.min(520, 46 * classes.length));
    chart(part, "Rows are classes, columns are classes from the network", side + 100, {
      tooltip: { formatter: (at) => `${escape(classes[at.value[1]])}, network: ${escape(shown[at.value[0]])}: ${number(at.value[2])}` },
      grid: { left: 130, top: 12, height: side, width: Math.min(side * 1.4, 760) },
      xAxis: { type: "category", data: shown, ...axisName("class from the network", 30), splitArea: { show: true } }, yAxis: { type: "category", data: classes, inverse: true, splitArea: { show: true }, name: "class", nameLocation: "middle", nameGap: 90 },
      visualMap: { min: 0, max: most, right: 10, top: 10, itemHeight: 100, calculable: false, text: [number(most), "0"], inRange: { color: ["#ffffff", "#9ecae1", "#08519c"] } },
      series: [{ type: "heatmap", data: points, label: { show: classes.length <= 24, color: "#000", backgroundColor: "rgba(255,255,255,.75)", padding: 2 } }],
    }, table(["class", ...shown], counts.map((row, label) => [classes[label], ...row.slice(0, shown.length).map((count) => number(count))])));
  }

  // ---- two results ---------------------------------------------------------------------------------------------------
  function comparison() {
    const [a, b] = results;
    const names = results.map((one, index) => `${"AB"[index]}: ${data.origins[index]?.name ?? one.model ?? "run"}${one.copies > 1 ? ` (${one.copies} copies)` : ""}`);
    const part = section("compared", "Side by side");
    const ta = totalOf(a) || {}, tb = totalOf(b) || {};
    const activity = (of) => of.activity || {};
    const sumOf = (of, key, field) => ((of[key] || []).length ? sum(of[key].map((row) => row[field] || 0)) : null);
    const ofCores = (of) => (of.breakdown_pj_per_timestep ? sum(Object.values(of.breakdown_pj_per_timestep)) / 1e3 : null);
    const lines = [
      ["energy of a timestep of one copy (µJ)", ta.energy_uj, tb.energy_uj], ["of that, events of the neuron cores (nJ)", ofCores(a), ofCores(b)], ["time of a timestep (µs)", ta.latency_us, tb.latency_us], ["power of one copy (mW)", ta.total_mw, tb.total_mw],
      ["power of all copies (mW)", a.job?.total_mw, b.job?.total_mw],
      ["energy-delay product (nJ s)", ta.edp_pjs / 1e3, tb.edp_pjs / 1e3], ["cores", a.cores_used, b.cores_used], ["chips", a.chips_used, b.chips_used],
      ["timesteps", a.timesteps, b.timesteps], ["spikes of compartments", sumOf(a, "populations", "spikes"), sumOf(b, "populations", "spikes")],
      ["synaptic events", sumOf(a, "cores", "synaptic_events") ?? activity(a).synaptic_events, sumOf(b, "cores", "synaptic_events") ?? activity(b).synaptic_events],
      ["accuracy", a.accuracy, b.accuracy],
    ].filter(([, x, y]) => isNumber(x) || isNumber(y));
    part.append(table(["", names[0], names[1], "B over A"], lines.map(([name, x, y]) => [name, number(x), number(y), isNumber(x) && isNumber(y) && x !== 0 ? number(y / x) : "–"])));
    const words = ["target", "deployment", "mode", "preset", "accounting", "transport", "digest"].filter((key) => a[key] || b[key]);
    part.append(element("details", {}, element("summary", {}, "Conditions of the runs"), table(["", ...names], words.map((key) => [key, a[key] ?? "–", b[key] ?? "–"]).concat([["input", (a.input || []).join(", "), (b.input || []).join(", ")]]), [0, 1, 2])));
    results.forEach((one, index) => { if ((one.warnings || []).length) { part.append(element("h3", {}, names[index])); warnings(part, one); } });
    function grouped(caption, unit, pick, scale = 1) {
      const [ofA, ofB] = [pick(a), pick(b)];
      const all = [...new Set([...Object.keys(ofA), ...Object.keys(ofB)])].filter((key) => ofA[key] || ofB[key]);
      const keys = all.slice(0, mostRows);
      if (!keys.length) return;
      const of = (one) => keys.map((key) => (pick(one)[key] ?? 0) * scale);
      chart(part, `${caption} (${unit})${firstOf(all, "rows")}`, 110 + 40 * keys.length, {
        tooltip: { trigger: "axis", axisPointer: { type: "shadow" }, valueFormatter: (x) => number(x) }, aria: { enabled: true, label: { enabled: false }, decal: { show: true } }, legend: { top: 0 }, grid: { left: 150, right: 30, top: 32, bottom: 40 },
        xAxis: { type: "value", ...axisName(unit, 24) }, yAxis: { type: "category", inverse: true, data: keys.map(spaced), axisLabel: { width: 140, overflow: "truncate" } },
        series: results.map((one, index) => ({ type: "bar", name: names[index], data: of(one) })),
      }, table(["", ...names], keys.map((key, index) => [spaced(key), number(of(a)[index]), number(of(b)[index])])));
    }
    const byName = (key, field) => (of) => Object.fromEntries((of[key] || []).map((row) => [row.name, row[field]]));
    grouped("Time of a mean timestep", "µs", (of) => of.time_us_per_timestep || {});
    grouped("Energy of the events of a mean timestep", "nJ", (of) => of.breakdown_pj_per_timestep || {}, 1e-3);
    grouped("Spikes by population", "spikes", byName("populations", "spikes"));
    grouped("Spikes of inputs", "spikes", byName("inputs", "spikes"));
  }

  // ---- provenance ----------------------------------------------------------------------------------------------------
  function originSection() {
    const part = section("origin", "Origin");
    part.append(element("h3", {}, "Command"), element("pre", {}, data.command));
    if (data.origins.length) part.append(element("h3", {}, "Files"), table(["kind", "name", "SHA-256"], data.origins.map((origin) => [origin.what, origin.name, origin.sha256]), [0, 1, 2]));
    const lines = [["nsim", data.nsim], ["target", result.target], ["seed of the input", result.seed ?? "none"], ["deployment", result.deployment], ["accounting", result.accounting], ["transport", result.transport], ["constants", result.preset]].filter(([, value]) => value);
    if (results.length === 1) part.append(element("h3", {}, "Conditions"), table(["", ""], lines, [0, 1]));
    if (results.length === 1 && (result.notes || []).length) part.append(element("h3", {}, "Notes"), element("ul", {}, result.notes.map((note) => element("li", {}, note))));
    if (results.length === 1 && (result.constants || []).length) {
      part.append(element("details", {}, element("summary", {}, `The ${result.constants.length} constants with their sources`), table(["constant", "value", "unit", "status", "source"], result.constants.map((one) => [spaced(one.name), number(one.value, 4), one.unit, one.status, one.source]), [0, 2, 3, 4])));
    }
    document.getElementById("footer").append(`nsim ${data.nsim}. Charts: Apache ECharts 5.6.0, Apache License 2.0. This file needs no network.`);
  }

  header();
  if (results.length > 1) comparison();
  else {
    hardwareSection();
    networkSection();
    fitSection();
    spikesSection();
    potentialsSection();
    stepsSection();
    goesSection();
    learningSection();
    agreementSection();
    classesSection();
  }
  originSection();
  // Draws charts from the top in slices of 30 ms, so that the page stays responsive.
  function next() {
    const begin = performance.now();
    while (waiting.length && performance.now() - begin < 30) waiting.shift().draw();
    if (waiting.length) setTimeout(next, 0);
    else document.documentElement.dataset.drawn = "all";
  }
  next();
})();
