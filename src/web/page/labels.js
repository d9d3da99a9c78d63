/**
 * Names, counts, newest grasp and message.
 *
 * @import {LastGrasp, Outcome, Session, State} from "./types.js"
 */
import { change, failureReason } from "./api.js";
import { button, byId, make, refill, say, style, toast } from "./dom.js";
import { agreement, agreementWords, balance, bytes, messageText, OUTCOMES, rigMark, short } from "./words.js";

const LOW_DISK_BYTES = 5e9;
const FULL_DISK_BYTES = 1e9;

/** @typedef {"object"|"scene"|"operator"} Field */
/** @type {[Field, string][]} */
const FIELDS = [
  ["object", "o"],
  ["scene", "n"],
  ["operator", "p"],
];

/** @type {Session|null} */
let session = null;
/** @type {Field} */
let edited = "object";

/** @param {State} state @param {(id: string) => void} show opens a grasp */
export function drawLabels(state, show) {
  session = state.session;
  drawHead(state);
  drawNames(state.session);
  drawCounts(state.session);
  refill(byId("last"), state.session.last, () => lastGrasp(state.session.last, show));
  drawMessage(state.session);
  drawRefusal(state.session);
}

/** @param {State} state */
function drawHead({ dataset, rig, clock, cameras, disk_free_bytes: free, session: { step } }) {
  say(byId("dataset"), dataset);
  say(byId("rig"), `rig ${rig}`);
  const [mark, tone] = rigMark(cameras);
  say(byId("rig-mark"), mark);
  style(byId("rig-mark"), tone);
  say(byId("clock"), clock);
  say(byId("disk"), free === null ? "" : `disk ${bytes(free)}`);
  style(byId("disk"), free === null || free >= LOW_DISK_BYTES ? "" : free < FULL_DISK_BYTES ? "slip" : "warning");
  const title = `${step} · ${dataset} · gripcast`;
  if (document.title !== title) document.title = title;
}

/** @param {Session} session */
function drawNames(session) {
  refill(byId("names"), FIELDS.map(([field]) => session[field]), () =>
    FIELDS.map(([field, key]) => {
      const empty = field === "object" ? "no object: set its name" : "–";
      const value = make("span", session[field] ? "value" : field === "object" ? "warning" : "faint", session[field] || empty);
      const node = button("", () => ask(field), "name");
      node.dataset.field = field;
      node.append(make("span", "faint", `${field} `), value, make("kbd", "", key));
      return node;
    }),
  );
}

/** @param {Session} session */
function drawCounts({ counts, object }) {
  refill(byId("counts"), [counts, object], () => {
    const max = Math.max(counts.stable, counts.slip, 1);
    const bar = (/** @type {"stable"|"slip"} */ name) => {
      const fill = make("i", `fill ${name}`);
      fill.style.width = `${(100 * counts[name]) / max}%`;
      return make("p", "count", make("span", name, name), make("b", "", String(counts[name])), make("span", "track", fill));
    };
    const hint = balance(counts);
    const here = make(
      "p",
      "here",
      make("span", "faint", "this object "),
      make("span", "stable", `${counts.object_stable} stable`),
      "  ",
      make("span", "slip", `${counts.object_slip} slip`),
    );
    return [here, bar("stable"), bar("slip"), make("p", hint.short ? "warning" : "faint", hint.text)];
  });
}

/** Outcome in its colour. @param {Outcome} outcome */
export function outcomeNode(outcome) {
  const colour = { stable: "stable", slip: "slip", unlabelled: "warning" }[outcome] ?? "";
  return make("b", colour, OUTCOMES[outcome] ?? outcome);
}

/** @param {string} mark */
export function markNode(mark) {
  const node = make("b", mark === "✓" ? "stable" : "warning", mark);
  node.title = agreementWords(mark);
  node.setAttribute("role", "img");
  node.setAttribute("aria-label", agreementWords(mark));
  return node;
}

/** @param {LastGrasp|null} last @param {(id: string) => void} show */
function lastGrasp(last, show) {
  if (!last) return [make("span", "faint", "no grasp yet")];
  const nodes = [make("span", "faint", "last "), button(short(last.id), () => show(last.id), "link"), ` ${last.object} → `, outcomeNode(last.outcome)];
  if (last.predicted) {
    nodes.push(make("span", "faint", ` predicted ${last.predicted.p_stable.toFixed(2)} `));
    const mark = agreement(last.predicted, last.outcome);
    if (mark) nodes.push(markNode(mark));
  }
  return nodes;
}

/** @param {Session} session */
function drawMessage({ message }) {
  const node = byId("message");
  node.hidden = !message;
  if (!message) return;
  style(node, message.level);
  say(node, messageText(message));
}

/** @param {Session} session */
function drawRefusal({ refusal }) {
  byId("refusal").hidden = !refusal;
  if (!refusal) return;
  refill(byId("refusal"), refusal, () => [
    make("ul", "", ...refusal.reasons.map((reason) => make("li", "", reason))),
    make(
      "p",
      "",
      refusal.can_override
        ? "Override with ! (recorded with the grasp)"
        : "Cannot be overridden: fix this and trigger again",
    ),
  ]);
}

/** Opens the dialog for a name. @param {Field} field */
export function ask(field) {
  if (!session) return;
  edited = field;
  const dialog = byId("name-dialog");
  const input = byId("name");
  say(byId("name-label"), `Name of the ${field}`);
  input.value = session[field];
  dialog.returnValue = "";
  dialog.showModal();
  input.focus();
  input.select();
}

export function startNames() {
  const dialog = byId("name-dialog");
  dialog.addEventListener("close", async () => {
    const name = byId("name").value.trim();
    if (dialog.returnValue !== "ok" || !name || name === session?.[edited]) return;
    try {
      const answer = await change("PUT", `api/${edited}`, { name });
      if (answer.result !== "accepted") toast(failureReason(answer), "error");
    } catch (error) {
      toast(`${edited} not changed: ${/** @type {Error} */ (error).message}`, "error");
    }
  });
}
