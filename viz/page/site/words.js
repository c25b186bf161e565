// What stands on the page in words: state, numbers, legend, messages.
const by = (id) => document.getElementById(id);

export function state(kind, text) {
  by("state").className = kind;
  by("state").textContent = text;
}

export function numbers(rows) {
  by("numbers").replaceChildren(...rows.map(({ label, text, alarm }) => {
    const row = document.createElement("tr"), name = document.createElement("th"), value = document.createElement("td");
    name.textContent = label;
    value.textContent = text;
    value.classList.toggle("alarm", alarm);
    row.append(name, value);
    return row;
  }));
}

export const old = (yes) => by("numbers").classList.toggle("old", yes);

export function words(text, warning = false) {
  by("words").hidden = !text;
  by("words").textContent = text;
  by("words").classList.toggle("warning", warning);
}

export function told(text, bad = false) {
  by("told").textContent = text;
  by("told").classList.toggle("bad", bad);
}

export function title(about) {
  document.title = `${about.name} · magmpm view`;
  by("title").textContent = about.name;
}

// Rows of [colors, text, whether it is a line].
export function legend(rows) {
  by("legend").replaceChildren(...rows.map(([colors, text, line]) => {
    const item = document.createElement("li"), marks = document.createElement("span");
    for (const color of colors) {
      const mark = document.createElement("i");
      mark.className = line ? "bar" : "";
      mark.style.background = color;
      marks.append(mark);
    }
    item.append(marks, text);
    return item;
  }));
}

export function marksOf(about) {
  const rows = [[[about.colors.magnetization], "magnetization", true], [[about.colors.field], "field", true]];
  if (about.target) rows.unshift([[about.colors.target], about.target_name, false]);
  return rows;
}

export function button(text, pressed, main = false) {
  const made = document.createElement("button");
  made.textContent = text;
  made.className = main ? "main" : "";
  made.addEventListener("click", pressed);
  return made;
}
