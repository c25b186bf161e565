// The page of `magmpm view`.
import { plain } from "./server.js";
import { state, words } from "./words.js";

try {
  const about = await plain("about");
  const view = about.kind === "motion" ? new (await import("./motion.js")).MotionView(about) : new (await import("./shape.js")).ShapeView(about);
  window.magmpm = view; // for tests and the curious
} catch (error) {
  state("failed", "can't begin");
  words(error.message);
}
