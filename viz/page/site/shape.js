// A scene at rest: each move of a slider asks for a preview and for the solution. Answers to values that are no longer set are dropped.
import { packed, plain } from "./server.js";
import { Panel } from "./panel.js";
import { Stage } from "./stage.js";
import * as page from "./words.js";

// Asks the server for one thing at a time, always with the newest values.
class Asker {
  constructor(name, view, patience) { Object.assign(this, { name, view, patience, busy: 0, done: -1, begun: 0 }); }

  // Ask, unless an answer is on its way; after `patience` ms ask anew all the same: the server then gives up the older one.
  async ask() {
    const { view } = this, version = view.version;
    if (version === this.done) return;
    if (this.busy && (this.busy > 1 || performance.now() - this.begun < this.patience)) return;
    this.busy += 1;
    this.begun = performance.now();
    this.done = version;
    try {
      const answer = await packed(this.name, { values: { ...view.panel.values }, surface: view.stage.surface });
      view.answered(this.name, version, answer);
    } catch (error) {
      view.refused(version, error);
    }
    this.busy -= 1;
    if (view.version !== this.done) this.ask();
  }
}

export class ShapeView {
  constructor(about) {
    this.about = about;
    this.version = 0; // of the values
    this.shown = { version: -1, state: "" };
    this.moved = [performance.now()]; // when each version's slider moved, ms
    this.latencies = []; // {version, state, ms}: from a slider's move to its shape on the screen
    this.stage = new Stage(about);
    this.panel = new Panel(document.getElementById("controls"), about.controls, () => this.turned());
    this.askers = [new Asker("solve", this, 400), new Asker("preview", this, Infinity)]; // what takes longest is asked first
    for (const [group, color] of Object.entries(about.region_colors)) this.panel.color(group, color);
    page.title(about);
    page.legend(page.marksOf(about));
    document.getElementById("subtitle").textContent = `at rest · ${about.effects.map((e) => e.replace("_", " ")).join(", ") || "no effects"} · ` +
      `${about.cells} cells across`;
    document.getElementById("buttons").append(page.button("Save this scene", () => this.save(), true), page.button("As in the file",
      () => this.panel.reset()), page.button("Picture", () => this.picture()));
    page.state("waiting", "solving (a first run compiles for 5 to 20 s)");
    this.ask();
  }

  turned() {
    this.version += 1;
    this.moved[this.version] = performance.now();
    page.told("");
    this.pending();
    this.ask();
  }

  // The values have moved on from what is shown.
  pending() {
    page.old(true);
    if (this.shown.version !== this.version) page.state("waiting", "solving: the shape shown is that of the last values");
  }

  ask() { for (const asker of this.askers) asker.ask(); }

  answered(name, version, answer) {
    const current = version === this.version;
    if (answer.state === "overtaken" || answer.state === "none" && !answer.words) return;
    if (answer.state === "failed" || answer.state === "none") {
      if (!current) return;
      if (answer.state === "failed") this.shown = { version, state: "failed" };
      page.state("failed", "no shape at rest was found here");
      page.words(answer.words);
      page.numbers([]);
      return;
    }
    // Never a shape of old values as if it were that of the new; and no preview over its solution.
    if (!current && answer.state === "solved") page.numbers(answer.numbers); // gray, as all numbers are until those of the newest values are there
    if (!current && !(answer.state === "preview" && version > this.shown.version)) return;
    if (answer.state === "preview" && this.shown.version === version && this.shown.state !== "") return;
    if (answer.surface !== this.stage.surface && !answer.arrays.triangles) return this.again(name);
    this.stage.show(answer);
    this.shown = { version, state: answer.state };
    this.tell(answer, current);
    this.stage.redraw(() => this.latencies.push({ version, state: answer.state, ms: performance.now() - this.moved[version] }));
  }

  // The surface that the answer belongs to was replaced meanwhile.
  again(name) {
    const asker = this.askers.find((one) => one.name === name);
    asker.done = -1;
    asker.ask();
  }

  tell(answer, current) {
    if (answer.state === "preview") {
      if (this.failedAt !== this.version) page.words("");
      page.state("preview", "preview by the rod; solving");
      return;
    }
    page.state("solved", `solved in ${(1e3 * answer.seconds).toFixed(0)} ms`);
    page.numbers(answer.numbers);
    page.old(!current);
    page.words(answer.warnings.join("\n"), true);
  }

  refused(version, error) {
    if (version !== this.version) return;
    this.shown = { version, state: "failed" };
    page.state("failed", "not a scene that can be solved");
    page.words(error.message);
  }

  async save() {
    try {
      const { path, command } = await plain("save", { values: this.panel.values });
      page.told(`Saved ${path}\n${command}`);
    } catch (error) { page.told(error.message, true); }
  }

  picture() {
    this.stage.draw();
    const link = document.createElement("a");
    link.href = this.stage.canvas.toDataURL("image/png");
    link.download = `${this.about.name.replace(/\s+/g, "-")}.png`;
    link.click();
  }
}
