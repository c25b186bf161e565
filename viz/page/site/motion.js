// A motion: play, pause and scrub; while it is being run, its frames appear as they are written.
import { packed, plain } from "./server.js";
import { Stage } from "./stage.js";
import * as page from "./words.js";

const SECONDS = 6; // that a motion lasts on the page at pace 1
const CURVES = { kinetic: "#CC6677", elastic: "#999933", total: "#1A1A1A" };

export class MotionView {
  constructor(about) {
    this.about = about;
    this.times = [];
    this.number = -1; // of the frame shown
    this.wanted = 0;
    this.playing = true;
    this.stage = new Stage(about);
    page.title(about);
    page.legend([...page.marksOf(about), [[about.colors.trace], "path of the tip, or of the middle", true]]);
    document.getElementById("subtitle").textContent =
      `${about.solved} · ${about.effects.map((e) => e.replaceAll("_", " ")).join(", ") || "no effects"}`;
    this.player();
    page.state("waiting", "reading");
    this.progress();
    requestAnimationFrame((now) => this.tick(now));
  }

  player() {
    const place = document.getElementById("player"), row = document.createElement("div"), below = document.createElement("div");
    place.hidden = false;
    row.className = below.className = "row";
    this.toggle = page.button("Pause", () => this.play(!this.playing), true);
    this.toggle.id = "toggle";
    this.scrub = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 0, value: 0, step: 1, id: "scrub" });
    this.scrub.setAttribute("aria-label", "frame");
    this.scrub.addEventListener("input", () => { this.play(false); this.show(+this.scrub.value); });
    this.time = document.createElement("span");
    this.time.className = "time";
    this.pace = document.createElement("select");
    for (const pace of [0.25, 0.5, 1, 2, 4]) this.pace.append(new Option(`${pace}×`, pace, pace === 1, pace === 1));
    this.pace.setAttribute("aria-label", "pace");
    row.append(this.scrub);
    below.append(this.toggle, this.pace, this.time);
    this.bar = Object.assign(document.createElement("progress"), { max: 1, value: 0, hidden: true });
    this.curves = document.createElement("canvas");
    this.curves.width = 630;
    this.curves.height = 300;
    place.append(row, below, this.bar, this.curves);
    window.addEventListener("keydown", (event) => {
      if (event.key === " " && event.target.tagName !== "BUTTON") { event.preventDefault(); this.play(!this.playing); }
    });
  }

  play(yes) {
    this.playing = yes;
    this.toggle.textContent = yes ? "Pause" : "Play";
    if (yes && this.wanted >= this.times.length - 1) this.wanted = 0;
  }

  // What frames there are; asked again while the run goes on.
  async progress() {
    try {
      const told = await plain("progress");
      const first = !this.times.length && told.times.length;
      this.times = told.times;
      this.told = told;
      this.scrub.max = Math.max(this.times.length - 1, 0);
      this.bar.hidden = !told.running;
      this.bar.value = this.times.length ? this.times.at(-1) / this.about.duration : 0;
      if (told.failure) page.words(told.failure);
      if (told.box) {
        const size = JSON.stringify(told.box);
        if (size !== this.size) { this.size = size; this.stage.frame(told.box); this.stage.still(); }
        if (told.trace.length > 1) this.stage.trace(told.trace);
        this.draw();
      }
      this.state(told);
      if (first) this.show(0);
      if (told.running) setTimeout(() => this.progress(), 700);
    } catch (error) {
      page.state("failed", "no answer");
      page.words(error.message);
    }
  }

  state(told) {
    if (told.failure) page.state("failed", `the run ended at ${this.said(this.times.at(-1) ?? 0)}`);
    else if (told.running) page.state("waiting", `running: ${this.said(this.times.at(-1) ?? 0)} of ${this.said(this.about.duration)}`);
    else page.state("solved", `${this.times.length} frames over ${this.said(this.about.duration)}`);
  }

  said(time) {
    const ms = this.about.duration < 1;
    return ms ? `${(1e3 * time).toFixed(1)} ms` : `${time.toFixed(3)} s`;
  }

  tick(now) {
    const { times } = this;
    if (this.playing && times.length > 1) {
      const share = (now - (this.before ?? now)) / 1e3 / SECONDS * +this.pace.value;
      this.wanted += share * (times.length - 1);
      if (this.wanted > times.length - 1) this.wanted = this.told.running ? times.length - 1 : 0;
      this.show(Math.floor(this.wanted), true);
    }
    this.before = now;
    requestAnimationFrame((next) => this.tick(next));
  }

  // Show a frame; while one is on its way, only the newest wish is kept.
  async show(number, playing = false) {
    if (!playing) this.wanted = number;
    if (number === this.number || this.asking) return;
    this.asking = true;
    try {
      const answer = await packed("frame", { number, surface: this.stage.surface });
      this.number = number;
      this.stage.show(answer);
      this.scrub.value = number;
      this.time.textContent = `t = ${this.said(answer.time)}`;
      this.draw();
    } catch (error) { page.words(error.message); this.play(false); }
    this.asking = false;
    if (!this.playing && this.wanted !== this.number) this.show(this.wanted);
  }

  // The energies over time, with a mark at the frame that is shown.
  draw() {
    const { energies } = this.told ?? {};
    if (!energies?.t?.length) { this.curves.hidden = true; return; }
    const c = this.curves.getContext("2d"), { width: w, height: h } = this.curves, left = 108, top = 34, bottom = h - 46;
    const names = Object.keys(CURVES).filter((name) => energies[name]);
    const values = names.flatMap((name) => energies[name]).filter(Number.isFinite), t = energies.t;
    const low = Math.min(0, ...values), high = Math.max(...values, low + 1e-30), end = Math.max(this.about.duration, t.at(-1));
    const x = (s) => left + (w - left - 16) * s / end, y = (v) => bottom - (bottom - top) * (v - low) / (high - low);
    c.clearRect(0, 0, w, h);
    c.font = "22px Helvetica, Arial, sans-serif";
    c.strokeStyle = "#bbb";
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(left, top); c.lineTo(left, bottom); c.lineTo(w - 16, bottom);
    c.stroke();
    c.fillStyle = "#666";
    c.textAlign = "right";
    const power = [[1, "J"], [1e-3, "mJ"], [1e-6, "µJ"], [1e-9, "nJ"]].find(([u]) => Math.max(high, -low) >= u) ?? [1e-12, "pJ"];
    for (const v of [low, high]) c.fillText(`${+(v / power[0]).toPrecision(2)} ${power[1]}`, left - 8, y(v) + 7);
    c.fillText(this.said(end), w - 16, h - 16);
    c.textAlign = "left";
    c.fillText("0", left, h - 16);
    let at = left + 8;
    for (const name of names) {
      c.strokeStyle = c.fillStyle = CURVES[name];
      c.lineWidth = 3;
      c.beginPath();
      energies[name].forEach((v, k) => c.lineTo(x(t[k]), y(v)));
      c.stroke();
      c.fillText(name, at, 22);
      at += c.measureText(name).width + 24;
    }
    c.fillStyle = "#666";
    c.fillText("energy", at, 22);
    const now = this.times[Math.max(this.number, 0)] ?? 0;
    c.strokeStyle = "#882255";
    c.lineWidth = 2;
    c.beginPath();
    c.moveTo(x(now), top); c.lineTo(x(now), bottom);
    c.stroke();
  }
}
