// The explorer: any metric of a study along any of its axes, with intervals, drawn by Observable Plot.
"use strict";
(() => {
  const root = document.getElementById("explorer");
  if (!root) return;
  const studies = JSON.parse(document.getElementById("studies").textContent);
  const COLOURS = ["#0072B2", "#D55E00", "#00835F", "#A6457F", "#A87200", "#2A86BD", "#5F6368", "#7A1F00"];
  const DASHES = ["", "6 3", "2 3", "8 3 2 3"];
  const LOG_SPAN = 30;
  const MOST_ROWS = 50;
  const find = (name) => root.querySelector(`[data-role="${name}"]`);
  const state = {};

  const made = (tag, properties = {}, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };

  // Numbers as the tables write them: two digits of the interval, or four of the value.
  const written = (mean, half) => {
    if (mean === null) return "–";
    const size = half ? 1 - Math.floor(Math.log10(half)) : 3 - Math.floor(Math.log10(Math.abs(mean) || 1));
    const short = (number, digits) => (number && (Math.abs(number) < 1e-4 || Math.abs(number) >= 1e7) ? number.toExponential(digits - 1) : number.toPrecision(digits));
    if (size > 6 || Math.abs(mean) >= 1e7) return short(mean, 4) + (half ? ` ± ${short(half, 2)}` : "");
    const digits = half || mean % 1 ? Math.max(size, 0) : 0;
    return mean.toFixed(digits) + (half === null ? "" : ` ± ${half ? half.toFixed(digits) : 0}`);
  };
  const plain = (value) => String(Number(value.toPrecision(6)));

  const axisOf = (name) => state.study.axes.findIndex((axis) => axis.name === name);
  const textAt = (axis, point) => state.study.axes[axis].texts[state.study.points[axis][point]];
  const several = (study) => study.axes.map((axis, i) => i).filter((i) => study.axes[i].values.length > 1);
  const metricLabel = (name) => state.study.metrics.find((metric) => metric.name === name).label;

  // One point in words, for the line below the chart and for its tip.
  const told = (point) => {
    const axes = several(state.study).map((axis) => `${state.study.axes[axis].label} ${textAt(axis, point)}`);
    const { mean, half, count, over } = state.study;
    const value = written(mean[state.metric][point], half[state.metric][point]);
    return { where: axes.join(", "), value: `${metricLabel(state.metric)}: ${value}`, of: over ? `${count[point]} ${over}` : "" };
  };

  // The axes that advance together with one, itself among them.
  const group = (axis) => {
    const { axes, together } = state.study;
    const names = together.find((some) => some.includes(axes[axis]?.name));
    return names ? names.map((name) => axes.findIndex((other) => other.name === name)) : [axis];
  };
  const drawn = (axis) => axis === state.x || axis === state.lines;
  // Axes of which one value is chosen: of those that advance together one, and none where one of them is drawn along.
  const chosen = () => several(state.study).filter((axis) => !group(axis).some(drawn) && group(axis)[0] === axis);

  const matching = () => {
    const { points, mean } = state.study;
    const fixed = chosen();
    return mean[state.metric].map((_, point) => point)
      .filter((point) => fixed.every((axis) => points[axis][point] === state.fixed[axis]));
  };

  function choose(study) {
    const axes = several(study);
    const start = study.start;
    const named = (name) => study.axes.findIndex((axis) => axis.name === name);
    state.study = study;
    const varies = (metric) => new Set(study.mean[metric.name]).size > 1;
    const wanted = study.metrics.find((metric) => metric.name === start.metric) ?? study.metrics.find(varies) ?? study.metrics[0];
    state.metric = wanted.name;
    state.x = start.x ? named(start.x) : axes[axes.length - 1] ?? 0;
    if (state.x < 0) state.x = axes[0] ?? 0;
    state.lines = start.lines ? named(start.lines) : axes.find((axis) => !group(axis).includes(state.x) && study.axes[axis].values.length <= 12) ?? -1;
    state.kind = "lines";
    state.log = null;
    state.all = false;
    state.shown = MOST_ROWS;
    state.sort = null;
    state.fixed = study.axes.map((axis, i) => {
      const wanted = (start.fixed ?? {})[axis.name];
      const place = wanted === undefined ? -1 : axis.texts.indexOf(String(wanted));
      return place >= 0 ? place : axis.values.length - 1;
    });
    hideMost(start.show);
  }

  function hideMost(show) {
    state.hidden = new Set();
    if (state.lines < 0) return;
    const { texts } = state.study.axes[state.lines];
    texts.forEach((text, i) => { if (show ? !show.includes(text) : i >= COLOURS.length) state.hidden.add(i); });
  }

  const select = (label, options, value, change) => {
    const element = made("select", {}, ...options.map(([key, text, off]) => made("option", { value: key, textContent: text, disabled: !!off })));
    element.value = value;
    element.addEventListener("change", () => { change(element.value); render(); });
    return made("label", {}, label, element);
  };

  function controls() {
    const { study } = state;
    const axes = several(study);
    const parts = [];
    if (study.metrics.length > 1) {
      parts.push(select("Metric", study.metrics.map((m) => [m.name, m.label]), state.metric, (value) => { state.metric = value; state.log = null; }));
    }
    if (axes.length > 1) {
      parts.push(select("Along", axes.map((i) => [i, study.axes[i].label]), state.x, (value) => {
        const before = state.x;
        state.x = Number(value);
        if (state.lines === state.x) { state.lines = before; hideMost(); }
      }));
      parts.push(select(state.kind === "map" ? "Upwards" : "A line per", [[-1, "–"], ...axes.filter((i) => i !== state.x).map((i) => [i, study.axes[i].label])], state.lines,
        (value) => { state.lines = Number(value); hideMost(); }));
    }
    for (const axis of chosen()) {
      const there = new Set(study.points[axis]);
      parts.push(select(study.axes[axis].label, study.axes[axis].texts.map((text, i) => [i, text, !there.has(i)]), state.fixed[axis],
        (value) => { state.fixed[axis] = Number(value); }));
    }
    if (state.lines >= 0) {
      parts.push(select("As", [["lines", "lines"], ["map", group(state.x).includes(state.lines) ? "colours" : "heat map"]], state.kind, (value) => { state.kind = value; }));
    }
    if (state.kind === "lines") {
      parts.push(select("Scale", [["auto", "automatic"], ["linear", "linear"], ["log", "logarithmic"]], state.log ?? "auto",
        (value) => { state.log = value === "auto" ? null : value; }));
    }
    // The choice that was just made keeps the focus.
    const focused = [...find("controls").querySelectorAll("select")].indexOf(document.activeElement);
    const label = focused >= 0 ? document.activeElement.parentElement.firstChild.textContent : "";
    find("controls").replaceChildren(...parts);
    if (label) {
      parts.find((part) => part.firstChild.textContent === label)?.querySelector("select").focus();
    }
  }

  function legend() {
    const box = find("legend");
    if (state.lines < 0 || state.kind === "map") {
      box.replaceChildren();
      return;
    }
    const { texts } = state.study.axes[state.lines];
    const there = new Set(matching().map((point) => state.study.points[state.lines][point]));
    box.replaceChildren(...texts.flatMap((text, i) => {
      if (!there.has(i)) return [];
      const tick = made("input", { type: "checkbox", checked: !state.hidden.has(i) });
      tick.addEventListener("change", () => {
        tick.checked ? state.hidden.delete(i) : state.hidden.add(i);
        chart();
        table();
      });
      const swatch = made("span", { className: "swatch" });
      swatch.style.borderTopColor = COLOURS[i % COLOURS.length];
      if (i >= COLOURS.length) swatch.style.borderTopStyle = "dashed";
      return [made("label", {}, tick, swatch, text)];
    }));
  }

  const visible = () => matching().filter((point) => state.kind === "map" || state.lines < 0 || !state.hidden.has(state.study.points[state.lines][point]));

  const say = (point) => {
    const { where, value, of } = told(point);
    find("told").textContent = [where, value, of].filter(Boolean).join("; ");
  };

  // `at` is the place of the point that the keyboard is on.
  function chart(at = -1) {
    state.at = at;
    const box = find("chart");
    const width = Math.max(280, box.clientWidth || root.clientWidth || 720);
    const rows = visible().filter((point) => state.study.mean[state.metric][point] !== null);
    state.order = [];
    find("told").textContent = "";
    if (!rows.length) {
      box.replaceChildren(made("p", { className: "soft", textContent: "Nothing was measured there; choose other values." }));
      return;
    }
    const both = state.kind === "map" && state.lines >= 0;
    const { options, order } = both ? (group(state.x).includes(state.lines) ? scatter : map)(rows, width) : lines(rows, width);
    const drawn = Plot.plot(options);
    // As one picture it has one name; its parts have none.
    drawn.querySelectorAll("g[aria-label]").forEach((part) => part.removeAttribute("aria-label"));
    drawn.setAttribute("role", "img");
    drawn.setAttribute("aria-label", `${metricLabel(state.metric)} along ${state.study.axes[state.x].label}; arrow keys go from point to point`);
    drawn.addEventListener("input", () => { if (drawn.value) say(drawn.value.point); });
    state.order = order;
    box.replaceChildren(drawn);
  }

  const tip = (point) => { const { where, value, of } = told(point); return [where.split(", ").join("\n"), value, of].filter(Boolean).join("\n"); };

  // What a point says of itself: the one that the keyboard is on, or the one nearest to the pointer.
  const tipOn = (rows, place) => {
    const look = { ...place, title: (row) => tip(row.point), fontSize: 13, lineHeight: 1.25 };
    return state.at >= 0 ? Plot.tip([rows[state.at]], look) : Plot.tip(rows, Plot.pointer({ ...look, maxRadius: 80 }));
  };

  function lines(points, width) {
    const { study, metric, x, lines: by } = state;
    const axis = study.axes[x];
    const known = points.filter((point) => !axis.numeric || axis.values[study.points[x][point]] !== null).map((point) => {
      const mean = study.mean[metric][point];
      const half = study.half[metric][point];
      return { point, mean, half, series: by < 0 ? 0 : study.points[by][point], value: axis.values[study.points[x][point]], place: study.points[x][point] };
    });
    const means = known.map((row) => row.mean);
    const log = (state.log ?? (Math.min(...means) > 0 && Math.max(...means) >= LOG_SPAN * Math.min(...means) ? "log" : "linear")) === "log" && Math.min(...means) > 0;
    // On a logarithmic axis an interval that reaches zero would swallow the chart.
    for (const row of known) {
      row.low = row.half === null ? row.mean : log ? Math.max(row.mean - row.half, 0.3 * row.mean) : row.mean - row.half;
      row.high = row.half === null ? row.mean : row.mean + row.half;
    }
    const series = [...new Set(known.map((row) => row.series))].sort((a, b) => a - b);
    const colour = (row) => COLOURS[row.series % COLOURS.length];
    if (!axis.numeric) {
      for (const row of known) row.value = row.place + (series.indexOf(row.series) - (series.length - 1) / 2) * Math.min(0.12, 0.7 / series.length);
    }
    known.sort((a, b) => a.series - b.series || a.value - b.value);
    const marks = [Plot.ruleY(log || Math.min(...known.map((row) => row.low)) > 0 ? [] : [0], { stroke: "#888" })];
    for (const one of series) {
      const mine = known.filter((row) => row.series === one);
      const ink = COLOURS[one % COLOURS.length];
      const spread = mine.filter((row) => row.half !== null);
      if (axis.numeric && mine.length > 1 && group(x).length === 1) {
        marks.push(Plot.areaY(spread, { x: "value", y1: "low", y2: "high", fill: ink, fillOpacity: 0.16 }));
        marks.push(Plot.lineY(mine, { x: "value", y: "mean", stroke: ink, strokeWidth: 1.8, strokeDasharray: DASHES[Math.floor(one / COLOURS.length) % DASHES.length] }));
      } else {
        marks.push(Plot.ruleX(spread, { x: "value", y1: "low", y2: "high", stroke: ink, strokeWidth: 2 }));
      }
      if (mine.length <= 40 || group(x).length > 1) marks.push(Plot.dot(mine, { x: "value", y: "mean", r: axis.numeric ? 3 : 4.5, fill: ink }));
    }
    marks.push(tipOn(known, { x: "value", y: "mean" }));
    const options = {
      width, height: Math.round(Math.min(460, Math.max(280, 0.55 * width))), marks,
      marginLeft: 56, marginRight: 24, marginBottom: 44, style: { fontSize: "13px", fontFamily: "inherit" },
      x: { axis: null },
      y: { axis: null, type: log ? "log" : "linear", nice: !log },
    };
const { room, ticks, text, tickRotate, ...scale } = axis.numeric ? along(axis, known.map((row) => row.value), width) : named(axis, width);
    options.marginBottom = room;
    Object.assign(options.x, scale);
    // Axes with their own texts: a logarithmic one would leave some out.
    marks.push(Plot.axisX(ticks, { text, tickRotate, label: axis.label, labelAnchor: "center", labelArrow: "none", fontSize: 13 }));
    const [least, most] = [Math.min(...known.map((row) => row.low)), Math.max(...known.map((row) => row.high))];
    const y = log && steps125(least, most).length > 1 ? steps125(least, most) : undefined;
    // One value, all the same, has no scale of its own.
    if (least === most) options.y.domain = [least - 0.1 * (Math.abs(least) || 1), least + 0.1 * (Math.abs(least) || 1)];
    const look = { label: metricLabel(metric), fontSize: 13 };
    marks.push(y ? Plot.axisY(y, { ...look, text: plain }) : Plot.axisY({ ...look, ticks: 6 }));
    marks.unshift(y ? Plot.gridY(y) : Plot.gridY({ ticks: 6 }));
    return { options, order: known };
  }

  // The scale of an axis of numbers: logarithmic where they span a factor of 30 and are not evenly spaced.
  function along(axis, seen, width) {
    const values = [...new Set(seen)].sort((a, b) => a - b);
    const positive = values.filter((value) => value > 0);
    const steps = values.slice(1).map((value, i) => value - values[i]);
    const even = values.length > 2 && Math.max(...steps) - Math.min(...steps) < 1e-3 * Math.max(...steps);
    const log = values[0] >= 0 && positive.length > 1 && positive.at(-1) >= LOG_SPAN * positive[0] && !even;
    const scale = { text: plain, room: 46 };
    const few = values.length <= Math.max(6, width / 80);
    if (!log) return { ...scale, ticks: few ? values : d3.ticks(values[0], values.at(-1), Math.max(3, Math.floor(width / 110))) };
    const ticks = few ? values : steps125(positive[0], positive.at(-1));
    if (values[0] > 0) return { ...scale, type: "log", ticks };
    return { ...scale, type: "symlog", constant: positive[0], ticks: few ? values : [0, ...ticks] };
  }

  // 1, 2 and 5 times powers of ten within bounds; powers alone where these are far apart.
  const steps125 = (low, high) => {
    const found = [];
    const factors = high / low > 3e3 ? [1] : [1, 2, 5];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
      found.push(...factors.map((factor) => Number(`${factor}e${power}`)));
    }
    return found.filter((tick) => tick >= 0.999 * low && tick <= 1.001 * high);
  };

  function named(axis, width) {
    const longest = Math.max(...axis.texts.map((text) => text.length));
    const steep = longest * 8 * axis.texts.length > width - 80;
    return {
      domain: [-0.5, axis.texts.length - 0.5], ticks: axis.texts.map((_, i) => i), text: (i) => axis.texts[i],
      tickRotate: steep ? -40 : 0, room: steep ? Math.min(160, 50 + 5 * longest) : 46,
    };
  }

  const shares = (rows) => {
    const means = rows.map((row) => row.mean);
    const [low, high] = [Math.min(...means), Math.max(...means)];
    const share = low > 0 && high >= LOG_SPAN * low
      ? (mean) => Math.log(mean / low) / Math.log(high / low) : (mean) => (high > low ? (mean - low) / (high - low) : 0.5);
    for (const row of rows) row.share = share(row.mean);
  };

  // Points of two axes that advance together, coloured from the lowest (dark) to the highest (yellow).
  function scatter(points, width) {
    const { study, metric, x, lines: y } = state;
    const rows = points.map((point) => ({
      point, mean: study.mean[metric][point], across: study.axes[x].values[study.points[x][point]], up: study.axes[y].values[study.points[y][point]],
    }));
    shares(rows);
    rows.sort((a, b) => a.mean - b.mean);
    const scales = [[x, "across", width], [y, "up", 460]].map(([axis, key, room]) => {
      const { ticks, text, room: margin, tickRotate, ...scale } = along(study.axes[axis], rows.map((row) => row[key]), room);
      return { ticks, text, scale };
    });
    const look = (axis) => ({ label: study.axes[axis].label, fontSize: 13, labelArrow: "none" });
    const options = {
      width, height: Math.round(Math.min(460, Math.max(280, 0.55 * width))), marginLeft: 70, marginRight: 24, marginBottom: 46,
      style: { fontSize: "13px", fontFamily: "inherit" }, color: { type: "identity" },
      x: { axis: null, ...scales[0].scale, inset: 8 }, y: { axis: null, ...scales[1].scale, inset: 8 },
      marks: [
        Plot.axisX(scales[0].ticks, { ...look(x), text: scales[0].text, labelAnchor: "center" }),
        Plot.axisY(scales[1].ticks, { ...look(y), text: scales[1].text }),
        Plot.gridX(scales[0].ticks), Plot.gridY(scales[1].ticks),
        Plot.dot([...rows].reverse(), { x: "across", y: "up", r: 6, fill: (row) => d3.interpolateCividis(row.share), stroke: "#666", strokeWidth: 0.5 }),
        tipOn(rows, { x: "across", y: "up" }),
      ],
    };
    return { options, order: rows };
  }

  function map(points, width) {
    const { study, metric, x, lines: y } = state;
    const rows = points.map((point) => ({
      point, mean: study.mean[metric][point], half: study.half[metric][point],
      column: study.points[x][point], row: study.points[y][point],
    }));
    shares(rows);
    rows.sort((a, b) => a.row - b.row || a.column - b.column);
    const texts = study.axes[y].texts;
    const marginLeft = Math.min(150, 30 + 7 * Math.max(...texts.map((text) => text.length)));
    const columns = study.axes[x].texts;
    const cell = (width - marginLeft) / columns.length;
    const options = {
      width, height: 90 + 34 * texts.length, marginLeft, marginBottom: 50,
      style: { fontSize: "13px", fontFamily: "inherit" }, color: { type: "identity" },
      x: { type: "band", domain: columns.map((_, i) => i), tickFormat: (i) => (i % Math.ceil(40 / cell) ? "" : columns[i]), label: study.axes[x].label, labelArrow: "none", padding: 0.03 },
      y: { type: "band", domain: texts.map((_, i) => i), reverse: study.axes[y].numeric, tickFormat: (i) => texts[i], label: study.axes[y].label, labelArrow: "none", padding: 0.05 },
      marks: [
        Plot.cell(rows, { x: "column", y: "row", fill: (row) => d3.interpolateCividis(row.share) }),
        cell < 38 ? null : Plot.text(rows, { x: "column", y: "row", text: (row) => written(row.mean, null), fill: (row) => (row.share > 0.5 ? "black" : "white"), fontSize: cell < 60 ? 10 : 13 }),
        tipOn(rows, { x: "column", y: "row" }),
      ],
    };
    return { options, order: rows };
  }

  // Arrow keys go from point to point; the pointer takes over where it moves.
  find("chart").addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!step || !state.order.length) return;
    event.preventDefault();
    const count = state.order.length;
    chart(state.at < 0 ? (step > 0 ? 0 : count - 1) : (state.at + step + count) % count);
    say(state.order[state.at].point);
  });
  find("chart").addEventListener("pointermove", () => { if (state.at >= 0) chart(); });

  function table() {
    const { study } = state;
    const axes = several(study);
    const points = state.all ? study.mean[study.metrics[0].name].map((_, point) => point) : visible();
    const keys = { axis: (i) => (point) => study.points[i][point], metric: (name) => (point) => study.mean[name][point] };
    if (state.sort) {
      const value = keys[state.sort.kind](state.sort.name);
      const sign = state.sort.up ? 1 : -1;
      points.sort((a, b) => (value(a) === null) - (value(b) === null) || sign * (value(a) - value(b)));
    }
    const head = made("tr", {}, ...axes.map((i) => column(study.axes[i].label, "axis", i)),
      ...study.metrics.map((metric) => column(metric.label, "metric", metric.name)));
    const body = points.slice(0, state.shown).map((point) => made("tr", {},
      ...axes.map((i) => made("td", { className: study.axes[i].numeric ? "num" : "", textContent: textAt(i, point) })),
      ...study.metrics.map(({ name }) => made("td", { className: "num", textContent: written(study.mean[name][point], study.half[name][point]) }))));
    const focused = document.activeElement?.closest?.("th") ? document.activeElement.textContent : "";
    find("table").replaceChildren(made("thead", {}, head), made("tbody", {}, ...body));
    if (focused) [...find("table").querySelectorAll("button")].find((button) => button.textContent === focused)?.focus();
    find("rows").textContent = `${Math.min(state.shown, points.length)} of ${points.length} rows` + (study.over ? `; mean ± half-width of its 95 % interval over ${study.over}` : "");
    find("more").hidden = points.length <= state.shown;
    find("all").setAttribute("aria-pressed", state.all);
    find("all").hidden = points.length === study.count.length && !state.all;
  }

  const column = (label, kind, name) => {
    const button = made("button", { type: "button", textContent: label });
    const sorted = state.sort && state.sort.kind === kind && state.sort.name === name;
    button.addEventListener("click", () => { state.sort = { kind, name, up: sorted ? !state.sort.up : true }; table(); });
    const head = made("th", { className: "num" }, button);
    head.scope = "col";
    if (sorted) head.setAttribute("aria-sort", state.sort.up ? "ascending" : "descending");
    return head;
  };

  function csv() {
    const { study } = state;
    const quoted = (text) => (/[",\n]/.test(text) ? `"${String(text).replaceAll('"', '""')}"` : String(text));
    const names = study.metrics.map((metric) => metric.name);
    const rows = [[...study.axes.map((axis) => axis.name), ...names.flatMap((name) => [name, `${name}_half`]), "members"]];
    study.count.forEach((count, point) => rows.push([...study.axes.map((axis, i) => axis.values[study.points[i][point]]),
      ...names.flatMap((name) => [study.mean[name][point] ?? "", study.half[name][point] ?? ""]), count]));
    const link = made("a", { download: `${study.name}.csv` });
    link.href = URL.createObjectURL(new Blob([rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n"], { type: "text/csv" }));
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  function render() {
    controls();
    legend();
    chart();
    table();
  }

  const picker = find("study");
  if (picker) {
    picker.append(...studies.map((study, i) => made("option", { value: i, textContent: study.title })));
    picker.addEventListener("change", () => { choose(studies[picker.value]); render(); });
  }
  find("more").addEventListener("click", () => { state.shown *= 4; table(); });
  find("all").addEventListener("click", () => { state.all = !state.all; state.shown = MOST_ROWS; table(); });
  find("csv").addEventListener("click", csv);
  // Links elsewhere on the page that say what to look at.
  for (const link of document.querySelectorAll("[data-explore]")) {
    link.addEventListener("click", () => {
      const wanted = JSON.parse(link.dataset.explore);
      const study = studies.find((one) => one.name === wanted.study || one.metrics.some((metric) => metric.name === wanted.metric)) ?? studies[0];
      choose({ ...study, start: { ...study.start, ...wanted } });
      if (picker) picker.value = studies.indexOf(study);
      render();
    });
  }
  let width = 0;
  new ResizeObserver(() => {
    if (Math.abs(find("chart").clientWidth - width) > 8) {
      width = find("chart").clientWidth;
      chart();
    }
  }).observe(find("chart"));
  choose(studies[0]);
  render();
})();
