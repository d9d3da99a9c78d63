/**
 * Steps and stability gauge, readable from two metres.
 *
 * @import {Prediction, Session, State} from "./types.js"
 */
import { attribute, byId, make, refill, say, style } from "./dom.js";
import { banner, duration, messageText, shownVerdict, STEPS } from "./words.js";

/** Time after which a verdict is read out by screen readers, ms. */
const SETTLED_MS = 1200;

/** @param {Session} session */
export function drawSteps(session) {
  const now = banner(session);
  const age = session.step === "grasp" && session.initial_age_s !== null ? ` ${duration(session.initial_age_s * 1e3)} ago` : "";
  const note = session.message && session.message.level !== "error" ? messageText(session.message) : "";
  refill(byId("steps"), [now, age, note], () =>
    Object.entries(STEPS).map(([name, { number }]) => {
      const here = number === now.number;
      const done = number < now.number;
      const item = make("li", here ? `here ${now.kind}` : done ? "done" : "");
      item.append(make("b", "digit", String(number)));
      const words = make("span", "words");
      if (here) words.append(make("b", "verb", now.verb), make("span", "todo", make("b", "", now.instruction), make("span", "note", note)));
      else words.append(`${name}${done ? " ✓" : ""}`);
      if (name === "initial" && done && age) words.append(make("small", "", age));
      item.append(words);
      if (here) item.setAttribute("aria-current", "step");
      return item;
    }),
  );
}

/** Text for screen readers when the step changes. @param {Session} session */
export function stepSentence(session) {
  const now = banner(session);
  return `Step ${now.number} of 3: ${now.verb}. ${now.instruction}`;
}

/**
 * @param {State} state
 * @param {string|null} staleReason why the state is out of date
 */
export function drawGauge(state, staleReason) {
  const prediction = staleReason ? null : finite(state.prediction);
  const verdict = prediction ? shownVerdict(prediction) : "none";
  style(byId("gauge"), verdict);
  say(byId("number"), prediction ? Math.min(Math.max(prediction.p_stable, 0), 1).toFixed(2) : "-.--");
  const reason = staleReason ?? state.no_prediction_reason ?? "waiting for the first prediction";
  say(byId("verdict"), prediction ? verdict.toUpperCase() : `no prediction: ${reason}`);
  drawBar(prediction);
  drawTitle(prediction, verdict);
  return verdict;
}

/** @param {Prediction|null} prediction */
function finite(prediction) {
  return prediction && Number.isFinite(prediction.p_stable) ? prediction : null;
}

/** @param {Prediction|null} prediction */
function drawBar(prediction) {
  const p = prediction ? Math.min(Math.max(prediction.p_stable, 0), 1) : 0;
  byId("fill").style.width = `${(100 * p).toFixed(1)}%`;
  const trough = byId("trough");
  attribute(trough, "aria-valuenow", p.toFixed(2));
  attribute(trough, "aria-valuetext", prediction ? `${p.toFixed(2)}, ${shownVerdict(prediction)}` : "no prediction");
  const threshold = prediction?.threshold ?? NaN;
  const mark = byId("threshold");
  mark.hidden = !(threshold >= 0 && threshold <= 1);
  mark.style.left = `${100 * threshold}%`;
  say(byId("threshold-value"), mark.hidden ? "" : `▲ ${threshold.toFixed(2)}`);
}

/** @param {Prediction|null} prediction @param {string} verdict */
function drawTitle(prediction, verdict) {
  byId("heuristic").hidden = !prediction?.heuristic;
  byId("unknown").hidden = prediction?.verdict !== "unsure";
  say(byId("unknown"), prediction?.unsure_reason ?? "unlike the training images");
  say(byId("model"), prediction?.model ?? "");
  style(byId("age"), verdict === "old" ? "warning" : "faint");
  say(byId("age"), prediction ? `frame ${duration(prediction.frame_age_ms)} old` : "");
  const timing = prediction && `result in ${duration(prediction.latency_ms)} · model ${prediction.engine_ms.toFixed(1)} ms`;
  say(byId("timing"), timing ?? "");
}

/** Screen reader output: steps at once, verdicts once they are stable. */
export class Reader {
  constructor() {
    this.step = "";
    this.verdict = "";
    this.read = "";
    this.timer = 0;
  }

  /** @param {Session} session @param {string} verdict */
  note(session, verdict) {
    const step = stepSentence(session);
    if (step !== this.step) {
      this.step = step;
      const loud = session.refusal ? `. ${session.refusal.reasons.join(". ")}` : "";
      say(byId(session.refusal ? "assertive" : "polite"), step + loud);
    }
    if (verdict === this.verdict) return;
    this.verdict = verdict;
    clearTimeout(this.timer);
    if (verdict === "none" || verdict === this.read) return;
    this.timer = setTimeout(() => {
      this.read = verdict;
      say(byId("polite"), `prediction ${verdict} ${byId("number").textContent}`);
    }, SETTLED_MS);
  }
}
