/**
 * Command buttons; they show the server's state only. What became of a tap is always said: done (the
 * state shows it), not carried out and why, or no answer.
 *
 * @import {ApiError} from "./api.js"
 * @import {CommandResponse, Seen, Session, State} from "./types.js"
 */
import { change, failureReason, resultOf } from "./api.js";
import { attribute, byId, say, style, toast } from "./dom.js";
import { newId } from "./sender.js";
import { commandName, STEPS } from "./words.js";

const NAMES = ["trigger", "stable", "slip", "undo", "redo", "initial", "override"];

/** The command without an answer yet. @type {string|null} */
let waiting = null;
/** Why nothing can be sent; null while connected. @type {string|null} */
let offline = "not connected";
/** Time after a tap during which the next does nothing: the second tap of a double tap would land on
 * a button of the next step, which has just appeared under the finger, ms. */
const DOUBLE_TAP_MS = 350;
let tappedAt = -Infinity;
/** @type {Session|null} */
let session = null;
/** A command whose connection broke. @type {{id: string, name: string}|null} */
let lost = null;
/** Message about the newest tap. @type {HTMLElement|null} */
let told = null;
/** @type {(state: State) => void} */
let received = () => {};

/** @param {Session|null} now @param {string|null} reason why nothing can be sent */
export function drawActions(now, reason) {
  session = now;
  offline = reason;
  if (!now) return;
  const step = STEPS[now.step];
  const trigger = byId("trigger");
  style(trigger, `action ${now.step}`);
  const busy = waiting ? "sending …" : null;
  say(trigger.querySelector("b"), now.saving ? "Saving …" : step.trigger);
  say(trigger.querySelector("small"), now.saving ? "hold still" : (busy ?? step.hint));
  byId("actions").classList.toggle("labelling", now.step === "label");
  say(byId("undo").querySelector("small"), now.undo ?? "nothing to undo");
  say(byId("redo").querySelector("small"), now.redo ?? "");
  byId("override").hidden = !now.refusal?.can_override;
  for (const name of NAMES) {
    const button = byId(name);
    // Set in the HTML until the first state; later it would drop the keyboard focus.
    button.disabled = false;
    attribute(button, "aria-disabled", isPossible(name) ? null : "true");
    attribute(button, "aria-busy", waiting === name ? "true" : null);
  }
}

/** Whether a button can lead to anything; the server decides. @param {string} name */
function isPossible(name) {
  if (!session || offline || waiting || session.saving) return false;
  switch (name) {
    case "trigger":
      return session.step !== "label";
    case "stable":
    case "slip":
      return session.last !== null && session.last.outcome !== name;
    case "undo":
      return session.undo !== null;
    case "redo":
      return session.redo !== null;
    case "initial":
      return session.step !== "initial";
    default:
      return true;
  }
}

/**
 * The command with what its sender saw. A label names its grasp and remains valid for longer; all
 * others belong to one state.
 * @param {string} text @param {Session} shown @returns {{command: string, seen: Seen}}
 */
function named(text, shown) {
  const { revision, last, undo, redo } = shown;
  if ((text === "stable" || text === "slip") && last) {
    return { command: `relabel ${last.id} ${text}`, seen: { outcome: last.outcome } };
  }
  const step = text === "undo" && undo ? { undo } : text === "redo" && redo ? { redo } : {};
  return { command: text, seen: { revision, ...step } };
}

/**
 * Sends a command, one at a time, so that a double tap is not two steps.
 * @param {string} text @param {number} pressedAt time of the press, `event.timeStamp`
 */
export async function command(text, pressedAt) {
  const name = session ? commandName(text, session) : text;
  if (!session || offline) return tell(`${name}: not sent: ${offline ?? "not connected"}`, "error");
  if (waiting || session.saving) return;
  const { command, seen } = named(text, session);
  const id = newId();
  waiting = text;
  lost = null;
  told?.remove();
  drawActions(session, offline);
  let answer = null;
  try {
    answer = await change("POST", "api/commands", { command }, { id, pressedAt, seen });
  } catch (error) {
    const { isUncertain, message } = /** @type {ApiError} */ (error);
    if (isUncertain) lost = { id, name };
    tell(`${name}: ${isUncertain ? "" : "NOT carried out: "}${message}`, "error");
  }
  waiting = null;
  if (answer) {
    received(answer.state);
    tellResult(name, answer);
  }
  drawActions(session, offline);
  if (!offline) askLost();
}

/** @param {string} name @param {CommandResponse} answer */
function tellResult(name, answer) {
  if (answer.result === "accepted") return;
  const shown = answer.state.session;
  // Refusals of guards and messages of the state are on every page already.
  if (answer.stale || (!shown.refusal && !shown.message)) tell(`${name}: NOT carried out: ${failureReason(answer)}`, "error");
}

/** Asks after a reconnection what became of the command whose connection broke; it is not sent again. */
export async function askLost() {
  if (!lost) return;
  const { id, name } = lost;
  lost = null;
  const answer = await resultOf(id).catch(() => null);
  if (!answer) return tell(`${name}: no answer: not known whether it was carried out; this is the state now`, "error");
  if (answer.result === "accepted") tell(`${name}: carried out; the answer was late`);
  else tell(`${name}: NOT carried out: ${failureReason(answer)}`, "error");
}

/** Says what became of the newest tap. @param {string} text @param {"info"|"error"} [level] */
function tell(text, level) {
  told?.remove();
  told = toast(text, level);
}

/** @param {(state: State) => void} state called with the state of an answer */
export function startActions(state) {
  received = state;
  const bar = byId("actions");
  // A click must not move the focus, or the next space would press this button again.
  bar.addEventListener("mousedown", (/** @type {MouseEvent} */ event) => event.preventDefault());
  bar.addEventListener("click", (/** @type {MouseEvent} */ event) => {
    const button = /** @type {HTMLElement} */ (event.target).closest("button");
    if (!button || event.timeStamp - tappedAt < DOUBLE_TAP_MS) return;
    // A tap without a connection is answered, too.
    const isDisabled = button.getAttribute("aria-disabled") === "true";
    if (isDisabled && !offline) return;
    tappedAt = event.timeStamp;
    command(button.dataset.command ?? "", event.timeStamp);
  });
}
