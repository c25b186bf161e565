// The sliders, in groups. The field's three components have strength and direction beside them: two ways to the same numbers.
const DEGREE = Math.PI / 180;

export class Panel {
  constructor(place, controls, changed) {
    this.values = Object.fromEntries(controls.map((control) => [control.id, control.value]));
    this.initial = { ...this.values };
    this.rows = {};
    this.changed = changed;
    const groups = new Map();
    for (const control of controls) {
      if (!groups.has(control.group)) groups.set(control.group, []);
      groups.get(control.group).push(control);
    }
    let open = 0;
    for (const [name, members] of groups) {
      const group = document.createElement("details"), summary = document.createElement("summary");
      group.open = open++ < 7;
      summary.textContent = name;
      group.dataset.group = name;
      group.append(summary);
      if (name !== "Numbers" && members[0].id.startsWith("field.uniform")) this.polar(group, members);
      for (const control of members) group.append(this.slider(control, (value) => this.turned(control.id, value)));
      place.append(group);
    }
    this.refreshPolar();
  }

  // A slider with a number to type beside it.
  slider({ id, label, unit, low, high, step, value }, moved, kind = "") {
    const row = document.createElement("label"), range = document.createElement("input"), number = document.createElement("input");
    const name = document.createElement("span"), units = document.createElement("small");
    row.title = id.startsWith("polar") ? "" : id; // its address
    row.className = `slider ${kind || (id.startsWith("field") ? "field" : "")}`;
    name.textContent = label;
    units.textContent = unit === "deg" ? "°" : unit;
    Object.assign(range, { type: "range", min: low, max: high, step: "any", value });
    Object.assign(number, { type: "number", step: "any" });
    range.dataset.id = id;
    number.dataset.number = id;
    const fine = 10 ** Math.floor(Math.log10(step));
    const show = (v) => { range.value = v; number.value = +(Math.round(v / fine) * fine).toFixed(6); };
    range.addEventListener("input", () => { const v = +(Math.round(range.value / step) * step).toFixed(9); number.value = v; moved(v); });
    number.addEventListener("change", () => {
      if (number.value === "" || !Number.isFinite(+number.value)) { show(this.values[id] ?? +range.value); return; }
      range.value = +number.value;
      moved(+number.value);
    });
    range.setAttribute("aria-label", `${label}, ${unit}`);
    number.setAttribute("aria-label", `${label}, ${unit}`);
    show(value);
    this.rows[id] = { show, low, high };
    row.append(name, range, number, units);
    return row;
  }

  polar(group, members) {
    const high = members[0].high;
    const rows = [["polar.strength", "strength", "mT", 0, high, high / 400], ["polar.azimuth", "azimuth", "deg", -180, 180, 1],
      ["polar.elevation", "elevation", "deg", -90, 90, 1]];
    for (const [id, label, unit, low, top, step] of rows) {
      group.append(this.slider({ id, label, unit, low, high: top, step, value: 0 }, (value) => this.turnPolar(id, value), "field"));
    }
    this.direction = { strength: 0, azimuth: 0, elevation: 0 };
  }

  // The field by strength and direction: its components follow.
  turnPolar(id, value) {
    this.direction[id.slice(6)] = value;
    const { strength, azimuth, elevation } = this.direction, e = elevation * DEGREE, a = azimuth * DEGREE;
    const field = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)].map((c) => +(strength * c).toFixed(9));
    field.forEach((value, k) => {
      this.values[`field.uniform[${k}]`] = value;
      this.rows[`field.uniform[${k}]`].show(value);
    });
    this.changed(this.values);
  }

  refreshPolar() {
    if (!this.direction) return;
    const [x, y, z] = [0, 1, 2].map((k) => this.values[`field.uniform[${k}]`]);
    const strength = Math.hypot(x, y, z);
    // Without strength the direction is kept for when it comes back.
    this.direction = strength > 0 ? { strength, azimuth: Math.atan2(y, x) / DEGREE, elevation: Math.atan2(z, Math.hypot(x, y)) / DEGREE }
      : { ...this.direction, strength };
    for (const [name, value] of Object.entries(this.direction)) this.rows["polar." + name].show(value);
  }

  turned(id, value) {
    this.values[id] = value;
    if (id.startsWith("field.uniform")) this.refreshPolar();
    this.changed(this.values);
  }

  reset() {
    Object.assign(this.values, this.initial);
    for (const [id, value] of Object.entries(this.values)) this.rows[id].show(value);
    this.refreshPolar();
    this.changed(this.values);
  }

  // The part's color before the name of its group.
  color(group, color) {
    const place = document.querySelector(`details[data-group="${CSS.escape(group)}"] summary`);
    if (!place) return;
    const mark = document.createElement("i");
    mark.style.background = color;
    place.prepend(mark);
  }
}
