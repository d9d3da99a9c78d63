/**
 * Names, counts, newest grasp and message.
 *
 * @import {LastGrasp, Outcome, Session, State} from "./types.js"
 */
import { change, failureReason } from "./api.js";
import { button, byId, make, refill, say, style, toast } from "./dom.js";
import { agreement, agreementWords, balance, bytes, messageText, number, OUTCOMES, probability, refusalRemedy, rigMark, short } from "./words.js";

const LOW_DISK_BYTES = 5e9;
const FULL_DISK_BYTES = 1e9;
/** Grasps left below which the disk is a warning: an hour's work. */
const FEW_GRASPS = 100;

/** @typedef {"object"|"scene"|"operator"} Field */
/** @type {[Field, string][]} */
const FIELDS = [
  ["object", "o"],
  ["scene", "n"],
  ["operator", "p"],
];

/** @type {Session|null} */
let session = null;
/** The open name dialog. */
let edited = {
  title: "",
  now: "",
  mayBeEmpty: false,
  /** @param {string} _name @returns {Promise<import("./types.js").CommandResponse>} */
  send: (_name) => Promise.reject(new Error("no dialog is open")),
};

/** @param {State} state @param {(id: string) => void} show opens a grasp */
export function drawLabels(state, show) {
  session = state.session;
  drawHead(state);
  drawStartReport(state);
  drawNames(state.session);
  drawCounts(state);
  refill(byId("last"), state.session.last, () => lastGrasp(state.session.last, show));
  drawMessage(state.session);
  drawRefusal(state.session);
}

/** @param {State} state */
function drawHead(state) {
  const { dataset, rig, clock, cameras, disk_free_bytes: free, grasps_left: left, session } = state;
  say(byId("dataset"), dataset);
  say(byId("rig"), `rig ${rig}`);
  const [mark, tone] = rigMark(cameras);
  say(byId("rig-mark"), mark);
  style(byId("rig-mark"), tone);
  say(byId("clock"), clock);
  refill(byId("disk"), [free && bytes(free), left], () => diskWords(free, left));
  const full = free !== null && (free < FULL_DISK_BYTES || left === 0);
  const low = free !== null && (free < LOW_DISK_BYTES || (left ?? Infinity) < FEW_GRASPS);
  style(byId("disk"), full ? "slip" : low ? "warning" : "");
  const title = `${session.step} · ${dataset} · gripcast`;
  if (document.title !== title) document.title = title;
}

/** Free space, and how many grasps fit; narrow screens omit the words. @param {number|null} free @param {number|null} left */
function diskWords(free, left) {
  if (free === null) return [];
  const words = [make("span", "word", "disk "), bytes(free)];
  if (left !== null) words.push(` · ${number(left)} `, make("span", "word", left === 1 ? "grasp " : "grasps "), "left");
  return words;
}

/** Warnings of the start report that were dismissed on this page. @type {Set<string>} */
const dismissed = new Set();

/** @param {State} state */
function drawStartReport(state) {
  const warnings = (state.start_report ?? []).filter(({ level, text }) => level !== "info" && !dismissed.has(text));
  const node = byId("start-report");
  node.hidden = warnings.length === 0;
  refill(node, warnings, () => [
    make("ul", "", ...warnings.map(({ text }) => make("li", "", text))),
    button("Close", () => {
      for (const { text } of warnings) dismissed.add(text);
      drawStartReport(state);
    }),
  ]);
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

/** @param {State} state */
function drawCounts({ session: { counts, object }, target_per_object: target }) {
  refill(byId("counts"), [counts, object, target], () => {
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
    const labelled = counts.object_stable + counts.object_slip;
    if (target) here.append(make("span", labelled < target ? "faint" : "stable", ` · ${labelled} of ${target}${labelled < target ? "" : " ✓"}`));
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
    nodes.push(make("span", "faint", ` predicted ${probability(last.predicted).toFixed(2)} `));
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
    make("p", "reason", refusal.reasons[0] ?? ""),
    make("ul", "", ...refusal.reasons.slice(1).map((reason) => make("li", "", reason))),
    make("p", "", refusalRemedy(refusal)),
  ]);
}

/** Opens the dialog for a name of the next grasps. @param {Field} field */
export function ask(field) {
  if (session) askName(`Name of the ${field}`, session[field], (name) => change("PUT", `api/${field}`, { name }));
}

/** Opens the dialog for the object of the newest grasp. */
export function askLastObject() {
  if (session?.last) askEdit(session.last.id, "object", session.last.object);
  else toast("no grasp to correct yet");
}

/** Opens the dialog for a name of a saved grasp. @param {string} id @param {Field} field @param {string} now */
export function askEdit(id, field, now) {
  const send = (/** @type {string} */ name) => change("PATCH", `api/grasps/${encodeURIComponent(id)}`, { [field]: name });
  askName(`${field} of grasp ${short(id)}`, now, send, field !== "object");
}

/**
 * @param {string} title @param {string} now
 * @param {(name: string) => Promise<import("./types.js").CommandResponse>} send
 * @param {boolean} mayBeEmpty
 */
function askName(title, now, send, mayBeEmpty = false) {
  edited = { title, now, send, mayBeEmpty };
  const dialog = byId("name-dialog");
  const input = byId("name");
  say(byId("name-label"), title);
  input.value = now;
  dialog.returnValue = "";
  dialog.showModal();
  input.focus();
  input.select();
}

export function startNames() {
  const dialog = byId("name-dialog");
  dialog.addEventListener("close", async () => {
    const name = byId("name").value.trim();
    const { title, now, send, mayBeEmpty } = edited;
    if (dialog.returnValue !== "ok" || (!name && !mayBeEmpty) || name === now) return;
    try {
      const answer = await send(name);
      if (answer.result !== "accepted") toast(failureReason(answer), "error");
    } catch (error) {
      toast(`${title} not changed: ${/** @type {Error} */ (error).message}`, "error");
    }
  });
}
