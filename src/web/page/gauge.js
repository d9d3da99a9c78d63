/**
 * Steps and stability gauge, readable from two metres.
 *
 * @import {Predicted, Session, State} from "./types.js"
 */
import { attribute, byId, make, refill, say, style } from "./dom.js";
import {
  adaptationWords,
  banner,
  duration,
  messageText,
  probability,
  savedVerdict,
  short,
  shownVerdict,
  STEPS,
  unsureWords,
} from "./words.js";

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
 * What the gauge shows.
 *
 * @typedef {object} Reading
 * @property {Predicted|null} prediction
 * @property {string} verdict `stable`, `slip`, `unsure`, `old`, or `none` without a prediction
 * @property {boolean} heuristic
 * @property {string} words why there is no prediction
 * @property {string} about to which frame the prediction belongs
 * @property {string} timing
 */

/** Models that were seen to be heuristics; saved predictions do not say it. @type {Set<string>} */
const heuristics = new Set();

/**
 * Draws the live prediction, or from the grasp to its label the one saved with the grasp.
 * @param {State} state
 * @param {string|null} staleReason why the state is out of date
 */
export function drawGauge(state, staleReason) {
  const { step, last } = state.session;
  const reading = staleReason ? none(staleReason) : step === "label" && last ? saved(last, state.lift) : live(state);
  const { prediction, verdict } = reading;
  style(byId("gauge"), verdict);
  say(byId("number"), prediction ? shownProbability(prediction).toFixed(2) : "-.--");
  say(byId("verdict"), prediction ? verdict.toUpperCase() : `no prediction: ${reading.words}`);
  drawBar(reading);
  drawTitle(reading);
  return verdict;
}

/** @param {string} words @returns {Reading} */
function none(words) {
  return { prediction: null, verdict: "none", heuristic: false, words, about: "", timing: "" };
}

/**
 * @param {NonNullable<Session["last"]>} last
 * @param {State["lift"]} lift
 * @returns {Reading}
 */
function saved({ id, predicted }, lift) {
  if (!isUsable(predicted)) return none(`none was saved with grasp ${short(id)}`);
  const about = `grasp ${short(id)}, before the lift`;
  const heuristic = heuristics.has(predicted.model);
  const timing = lift ? `in the lift ${lift.p_stable.toFixed(2)} ${liftWord(lift)}` : "";
  return { prediction: predicted, verdict: savedVerdict(predicted), heuristic, words: "", about, timing };
}

/** @param {NonNullable<State["lift"]>} lift */
function liftWord({ is_slipping, is_stable }) {
  return is_slipping ? "SLIPPING" : is_stable ? "STABLE" : "SLIP";
}

/** @param {State} state @returns {Reading} */
function live({ prediction, no_prediction_reason: reason }) {
  if (!isUsable(prediction)) return none(reason ?? "waiting for the first prediction");
  const { heuristic, model, frame_age_ms: age, latency_ms: latency, engine_ms: engine } = prediction;
  if (heuristic) heuristics.add(model);
  return {
    prediction,
    verdict: shownVerdict(prediction),
    heuristic,
    words: "",
    about: `frame ${duration(age)} old`,
    timing: `result in ${duration(latency)} · model ${engine.toFixed(1)} ms`,
  };
}

/**
 * @template {Predicted} P
 * @param {P|null} prediction
 * @returns {prediction is P}
 */
function isUsable(prediction) {
  return prediction !== null && Number.isFinite(prediction.p_stable);
}

/** @param {Predicted} prediction */
function shownProbability(prediction) {
  return Math.min(Math.max(probability(prediction), 0), 1);
}

/** @param {Reading} reading */
function drawBar({ prediction, verdict }) {
  const p = prediction ? shownProbability(prediction) : 0;
  byId("fill").style.width = `${(100 * p).toFixed(1)}%`;
  const trough = byId("trough");
  attribute(trough, "aria-valuenow", p.toFixed(2));
  attribute(trough, "aria-valuetext", prediction ? `${p.toFixed(2)}, ${verdict}` : "no prediction");
  const threshold = prediction?.threshold ?? NaN;
  const mark = byId("threshold");
  mark.hidden = !(threshold >= 0 && threshold <= 1);
  mark.style.left = `${100 * threshold}%`;
  say(byId("threshold-value"), mark.hidden ? "" : `▲ ${threshold.toFixed(2)}`);
}

/** @param {Reading} reading */
function drawTitle({ prediction, verdict, heuristic, about, timing }) {
  byId("heuristic").hidden = !heuristic;
  byId("unknown").hidden = verdict !== "unsure";
  say(byId("unknown"), prediction ? unsureWords(prediction) : "");
  say(byId("adapted"), prediction ? adaptationWords(prediction) : "");
  say(byId("model"), prediction?.model ?? "");
  style(byId("about"), verdict === "old" ? "warning" : "faint");
  say(byId("about"), about);
  say(byId("timing"), timing);
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
