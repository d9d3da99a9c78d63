/**
 * Command buttons; they show the server's state only.
 *
 * @import {Session} from "./types.js"
 */
import { ApiError, change, failureReason } from "./api.js";
import { attribute, byId, say, style, toast } from "./dom.js";
import { STEPS } from "./words.js";

/** Whether a command is pending. */
let waiting = false;
let linked = false;
/** Time after a tap during which the next does nothing: the second tap of a double tap would land on
 * a button of the next step, which has just appeared under the finger, ms. */
const DOUBLE_TAP_MS = 350;
let tappedAt = -Infinity;
/** @type {Session|null} */
let session = null;

/** @param {Session|null} now @param {boolean} up whether the server is connected */
export function drawActions(now, up) {
  session = now;
  linked = up;
  if (!now) return;
  const step = STEPS[now.step];
  const trigger = byId("trigger");
  style(trigger, `action ${now.step}`);
  say(trigger.querySelector("b"), now.saving ? "Saving …" : step.trigger);
  say(trigger.querySelector("small"), now.saving ? "hold still" : step.hint);
  byId("actions").classList.toggle("labelling", now.step === "label");
  say(byId("undo").querySelector("small"), now.undo ?? "nothing to undo");
  say(byId("redo").querySelector("small"), now.redo ?? "");
  byId("override").hidden = !now.refusal?.can_override;
  for (const name of ["trigger", "stable", "slip", "undo", "redo", "initial", "override"]) {
    // `disabled` would drop the keyboard focus.
    attribute(byId(name), "aria-disabled", isPossible(name) ? null : "true");
  }
}

/** Whether a button can lead to anything; the server decides. @param {string} name */
function isPossible(name) {
  if (!session || !linked || waiting || session.saving) return false;
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
 * Sends a command, one at a time, so that a double tap is not two steps.
 * @param {string} text
 */
export async function command(text) {
  if (!linked) {
    toast("not sent: no connection to gripcast", "error");
    return;
  }
  if (waiting || session?.saving) return;
  waiting = true;
  drawActions(session, linked);
  try {
    const answer = await change("POST", "api/commands", { command: text });
    const shown = answer.state?.session;
    // Refusals and messages of the state are on every page already.
    if (answer.result !== "accepted" && !shown?.refusal && !shown?.message) toast(failureReason(answer), "error");
  } catch (error) {
    const lost = error instanceof ApiError && error.status === 0;
    toast(lost ? `no response to “${text}”: check the step before you press again` : `${text}: ${/** @type {Error} */ (error).message}`, "error");
  } finally {
    waiting = false;
    drawActions(session, linked);
  }
}

export function startActions() {
  const bar = byId("actions");
  // A click must not move the focus, or the next space would press this button again.
  bar.addEventListener("mousedown", (/** @type {MouseEvent} */ event) => event.preventDefault());
  bar.addEventListener("click", (/** @type {MouseEvent} */ event) => {
    const button = /** @type {HTMLElement} */ (event.target).closest("button");
    if (!button || button.getAttribute("aria-disabled") === "true") return;
    const now = performance.now();
    if (now - tappedAt < DOUBLE_TAP_MS) return;
    tappedAt = now;
    command(button.dataset.command ?? "");
  });
}
