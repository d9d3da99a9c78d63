/**
 * Texts of the page, the same as on the terminal screen. No DOM access.
 *
 * @import {Camera, Counts, Force, Outcome, Predicted, Prediction, Refusal, Session, Shear, State, Step} from "./types.js"
 */

/** Frame age above which a prediction is shown as old, ms. */
const STALE_MS = 500;
/** Minimum difference of the label counts for a hint; otherwise a tenth of all labels. */
const MIN_IMBALANCE = 5;
/** Fraction of the nominal frame rate below which the rate is a warning. */
const SLOW_FRACTION = 0.9;
/** Frame age above which it is a warning, nominal intervals. */
const OLD_INTERVALS = 3;

/** The steps in order. */
export const STEPS = {
  initial: {
    number: 1,
    verb: "OPEN",
    instruction: "OPEN THE GRIPPER, then “Initial”",
    trigger: "Initial",
    hint: "take the initial frame",
  },
  grasp: {
    number: 2,
    verb: "CLOSE",
    instruction: "CLOSE THE GRIPPER, then “Grasp”",
    trigger: "Grasp",
    hint: "take the grasp frame",
  },
  label: {
    number: 3,
    verb: "LIFT",
    instruction: "LIFT, then “Stable” or “Slip”",
    trigger: "Label",
    hint: "stable or slip?",
  },
};

/** Word on the button of a command. @param {string} text @param {Session} session */
export function commandName(text, session) {
  const words = { trigger: STEPS[session.step].trigger, initial: "Initial again" };
  return words[/** @type {"trigger"} */ (text)] ?? text.charAt(0).toUpperCase() + text.slice(1);
}

export const OUTCOMES = { stable: "STABLE", slip: "SLIP", unlabelled: "not labelled" };

const PARTS = {
  left: "LEFT GELSIGHT",
  right: "RIGHT GELSIGHT",
  rgb: "COLOUR CAMERA",
  depth: "DEPTH CAMERA",
  external: "EXTERNAL CAMERA",
};

/** A time in the unit that reads best: `18 ms`, `1.4 s`, `6 min`, `3 h`. @param {number} ms */
export function duration(ms) {
  if (!Number.isFinite(ms)) return "? ms";
  if (ms < 999.5) return `${ms.toFixed(0)} ms`;
  if (ms < 9950) return `${(ms / 1e3).toFixed(1)} s`;
  if (ms < 89500) return `${(ms / 1e3).toFixed(0)} s`;
  if (ms < 5.4e6) return `${(ms / 60e3).toFixed(0)} min`;
  return `${(ms / 3.6e6).toFixed(0)} h`;
}

/** Decimal units, as disks are sold. @param {number} count */
export function bytes(count) {
  const gb = count / 1e9;
  if (gb >= 9950) return `${(gb / 1e3).toFixed(0)} TB`;
  if (gb >= 9.95) return `${gb.toFixed(0)} GB`;
  if (gb >= 1) return `${gb.toFixed(1)} GB`;
  return `${(gb * 1e3).toFixed(0)} MB`;
}

/** Last part of a grasp id: `7f3a`. @param {string} id */
export function short(id) {
  return id.slice(id.lastIndexOf("-") + 1);
}

/** Local date and time. @param {string} rfc3339 */
export function moment(rfc3339) {
  const time = new Date(rfc3339);
  if (Number.isNaN(time.getTime())) return rfc3339;
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const day = `${time.getFullYear()}-${two(time.getMonth() + 1)}-${two(time.getDate())}`;
  return `${day} ${two(time.getHours())}:${two(time.getMinutes())}`;
}

/** A number of grasps: `12,400`. @param {number} count */
export function number(count) {
  return count.toLocaleString("en");
}

/** What to do after a refusal, in the words of the buttons. @param {Refusal} refusal */
export function refusalRemedy({ stage, can_override }) {
  const { trigger } = STEPS[/** @type {Step} */ (stage)] ?? STEPS.grasp;
  const again = `Fix this, then “${trigger}” again`;
  return can_override ? `${again}; or “Override”, which is recorded with the grasp.` : `${again}. It cannot be overridden.`;
}

/** Banner of the current step. @param {Session} session */
export function banner(session) {
  const step = STEPS[session.step];
  if (session.saving) return { ...step, kind: "saving", verb: "SAVING", instruction: "hold still" };
  if (session.refusal) {
    return { ...step, kind: "refused", verb: "REFUSED", instruction: `${session.refusal.stage.toUpperCase()} NOT TAKEN` };
  }
  return { ...step, kind: session.step };
}

/** Text of a message with its level. @param {NonNullable<Session["message"]>} message */
export function messageText({ level, text }) {
  return { info: "", warning: "warning: ", error: "ERROR: " }[level] + text;
}

/**
 * The displayed verdict: that of the prediction, or "old".
 * @param {Prediction} prediction
 */
export function shownVerdict(prediction) {
  const fresh = prediction.frame_age_ms <= STALE_MS;
  return fresh && Number.isFinite(prediction.p_stable) ? prediction.verdict : "old";
}

/** The verdict of a saved prediction. @param {Predicted} predicted */
export function savedVerdict(predicted) {
  const { threshold, ood_score, unsure_reason, set } = predicted;
  if (unsure_reason || (ood_score ?? 0) > 1) return "unsure";
  if (set && set.stable === set.slip) return "unsure";
  if (set) return set.stable ? "stable" : "slip";
  return probability(predicted) >= threshold ? "stable" : "slip";
}

/** The probability that is shown: adapted to the rig's labels where it is. @param {Predicted} predicted */
export function probability({ p_stable, adapted }) {
  return adapted?.p_stable ?? p_stable;
}

/** Why a verdict is "unsure". @param {Predicted} predicted */
export function unsureWords({ ood_score, unsure_reason, set }) {
  if (unsure_reason) return unsure_reason;
  if (set && !((ood_score ?? 0) > 1)) return `can't tell at an error rate of ${set.error_rate}`;
  return "unlike the training images";
}

/** Adaptation to the rig's labels, with the model's own probability. @param {Predicted} predicted */
export function adaptationWords({ p_stable, adapted }) {
  if (!adapted) return "";
  const labels = `${adapted.labels} ${adapted.labels === 1 ? "label" : "labels"}`;
  return `adapted to ${labels}: base rate ${adapted.base_rate.toFixed(2)}, model ${p_stable.toFixed(2)}`;
}

/** `✓` if label and prediction agree, `✗` if not, `?` for out-of-distribution images.
 * @param {Predicted|null} prediction @param {Outcome} outcome */
export function agreement(prediction, outcome) {
  if (!prediction) return "";
  const verdict = savedVerdict(prediction);
  if (verdict === "unsure") return "?";
  if (outcome === "unlabelled") return "";
  return verdict === outcome ? "✓" : "✗";
}

/** Meaning of an agreement mark. @param {string} mark */
export function agreementWords(mark) {
  return { "✓": "prediction and label agree", "✗": "prediction and label disagree", "?": "the images cannot tell" }[mark] ?? "";
}

/** Hint which label has fewer grasps. @param {Counts} counts */
export function balance({ stable, slip, unlabelled }) {
  const difference = Math.abs(stable - slip);
  const short = difference >= Math.max(MIN_IMBALANCE, Math.floor((stable + slip) / 10));
  const hint = short ? `need ${difference} ${stable > slip ? "slip" : "stable"}` : "balanced";
  return { short, text: unlabelled ? `${hint} · ${unlabelled} unlabelled` : hint };
}

/** Whether the camera needs a person: not while it opens or has no depth, nor at the end of a recording.
 * @param {Camera} camera */
export function isFault({ state }) {
  return ["damaged", "silent", "frozen", "unplugged", "unavailable"].includes(state);
}

/** Whether whole new frames arrive. @param {Camera} camera */
export function deliversFrames({ state }) {
  return ["live", "damaged", "no_valid_depth"].includes(state);
}

/** A fraction in percent; never 0 or 100 for what is neither. @param {number} fraction */
export function percent(fraction) {
  const value = fraction * 100;
  if (value > 0 && value < 1) return "< 1 %";
  if (value > 99 && value < 100) return "> 99 %";
  return `${value.toFixed(0)} %`;
}

/** State of a camera in a few words. @param {Camera} camera */
export function stateWords({ state, for_s, fraction }) {
  if (state === "opening") return "opening …";
  if (state === "ended") return "recording ended";
  if (state === "live") return "live";
  if (state === "no_valid_depth") return "sees nothing";
  if (fraction !== undefined) return `${state.toUpperCase()} ${percent(fraction)}`;
  return for_s === undefined ? state.toUpperCase() : `${state.toUpperCase()} ${duration(for_s * 1e3)}`;
}

/** Name of the failed camera, its state and the remedy. @param {Camera} camera */
export function fault(camera) {
  const remedies = {
    damaged: "REPLUG IT, or use another cable or port: many of its images are damaged",
    frozen: "REPLUG IT: the image does not change",
    unplugged: "PLUG IT IN: it reopens by itself",
    unavailable: "FREE IT: it is plugged in, but cannot be opened",
    silent: "REPLUG IT: no frames arrive",
  };
  return {
    part: PARTS[camera.role] ?? String(camera.role).toUpperCase(),
    words: stateWords(camera),
    remedy: remedies[/** @type {"frozen"} */ (camera.state)] ?? "",
  };
}

/** What the faults mean for triggers. @param {Camera[]} failed */
export function consequence(failed) {
  return failed.every(deliversFrames)
    ? "triggers use the images that are whole"
    : "capture is blocked until the camera recovers";
}

/** Product, serial number and port of a camera. @param {Camera} camera */
export function identity({ product, serial, port }) {
  const parts = [product, serial && `serial ${serial}`, port ? `usb ${port}` : "port unknown"];
  return parts.filter(Boolean).join(" · ");
}

/** Mark of the whole rig and its style. @param {Camera[]} cameras @returns {[string, string]} */
export function rigMark(cameras) {
  if (cameras.every(({ state }) => state === "live")) return ["✓", "stable"];
  return cameras.every(deliversFrames) ? ["!", "warning"] : ["✗", "slip"];
}

/** @param {Camera[]} cameras */
export function liveCount(cameras) {
  const live = cameras.filter((camera) => camera.state === "live").length;
  return `${live}/${cameras.length} cameras live`;
}

/** Frame rate and age of a live camera, each with whether it is a warning. @param {Camera} camera */
export function rates({ measured_fps, nominal_fps, frame_age_ms }) {
  return {
    rate: `${measured_fps.toFixed(1)}/${nominal_fps.toFixed(0)} fps`,
    slow: measured_fps < SLOW_FRACTION * nominal_fps,
    age: frame_age_ms === null ? "–" : duration(frame_age_ms),
    old: frame_age_ms === null || frame_age_ms * nominal_fps > OLD_INTERVALS * 1e3,
  };
}

/** Non-zero error counters, and why no pose can be measured. @param {Camera} camera */
export function problems(camera) {
  const counters = [
    [camera.sequence_gaps, "lost"],
    [camera.damaged, "damaged"],
    [camera.reconnects, "reopened"],
  ];
  const words = counters.filter(([count]) => count).map(([count, word]) => `${count} ${word}`);
  if (camera.markers && !camera.markers.ok) words.push(`no pose: ${camera.markers.text}`);
  return words.join(" ");
}

/** The normal force in a few words, `12.3 N ± 2`; empty where nothing is known. @param {Force} [force] */
export function forceWords(force) {
  if (!force) return "";
  const { normal_n: newtons, normal_std_n: deviation, is_calibrated: isCalibrated } = force;
  const about = deviation < 0.95 ? deviation.toFixed(1) : deviation.toFixed(0);
  return `${newtons.toFixed(1)} N ± ${about}${isCalibrated ? "" : " uncalibrated"}`;
}

/** Confidence below which a shear is shown as uncertain. */
const UNCERTAIN = 0.5;
/** Displacement from which a direction is shown, mm. */
const MIN_DIRECTION_MM = 0.02;

/** The shear in a few words, `shear 0.42 mm ↗ slip 12 %`; empty where nothing can be said. @param {Shear} [shear] */
export function shearWords(shear) {
  if (!shear?.summary) return "";
  const { confidence, mean_displacement_mm: [x, y], slip_ratio: ratio } = shear.summary;
  const length = Math.hypot(x, y);
  const eighth = Math.round(Math.atan2(y, x) / (Math.PI / 4));
  const direction = length < MIN_DIRECTION_MM ? "" : ` ${"→↘↓↙←↖↑↗"[(eighth + 8) % 8]}`;
  const slip = ratio === null ? "" : ` slip ${Math.round(100 * ratio)} %`;
  return `shear ${confidence < UNCERTAIN ? "~" : ""}${length.toFixed(2)} mm${direction}${slip}`;
}
