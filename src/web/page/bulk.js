/**
 * Labels many grasps: selection in the list, confirmation, one request after the other. Each label is
 * a step of its own for undo.
 *
 * @import {GraspSummary, Outcome} from "./types.js"
 */
import { change, failureReason } from "./api.js";
import { button, byId, make, refill, say, toast } from "./dom.js";
import { number, OUTCOMES, short } from "./words.js";

/** @type {[Outcome, string][]} */
const LABELS = [
  ["stable", "Stable"],
  ["slip", "Slip"],
  ["unlabelled", "No label"],
];

/** Whether cards are selected instead of opened. */
let selecting = false;
/** Selected grasps by id. @type {Map<string, GraspSummary>} */
const selected = new Map();
/** Progress of a run; null while none runs. @type {{done: number, all: number, stop: boolean}|null} */
let run = null;
/** @type {Outcome} */
let wanted = "stable";
/** @type {() => GraspSummary[]} */
let shown = () => [];
let changed = () => {};
let reload = () => {};

export function isSelecting() {
  return selecting;
}

/** Whether a run is in progress; the list is loaded at its end. */
export function isLabelling() {
  return run !== null;
}

/** @param {string} id */
export function isSelected(id) {
  return selected.has(id);
}

/** Selects or deselects a grasp. @param {GraspSummary} grasp */
export function toggleSelected(grasp) {
  if (run) return;
  if (!selected.delete(grasp.id)) selected.set(grasp.id, grasp);
  changed();
}

/** Takes over new labels of selected grasps; what left the list is not selected any more. @param {GraspSummary[]} list */
export function updateSelected(list) {
  const newest = new Map(list.map((grasp) => [grasp.id, grasp]));
  for (const id of [...selected.keys()]) {
    const grasp = newest.get(id);
    if (grasp) selected.set(id, grasp);
    else selected.delete(id);
  }
  drawBulk();
}

/** Draws the bar of the selection. */
export function drawBulk() {
  byId("bulk").hidden = !selecting;
  byId("select").setAttribute("aria-pressed", String(selecting));
  refill(byId("bulk"), [selecting, selected.size, run], () => {
    if (run) {
      const { done, all } = run;
      return [make("b", "", `${number(done)} of ${number(all)} labelled`), button("Stop", stop)];
    }
    const labels = LABELS.map(([outcome, text]) => {
      const node = button(text, () => confirm(outcome), outcome);
      if (!selected.size) node.setAttribute("aria-disabled", "true");
      return node;
    });
    return [make("b", "", `${number(selected.size)} selected`), button("All shown", selectShown), ...labels, button("Done", finish)];
  });
}

function stop() {
  if (run) run.stop = true;
}

function selectShown() {
  for (const grasp of shown()) selected.set(grasp.id, grasp);
  changed();
}

function finish() {
  selecting = false;
  selected.clear();
  changed();
}

/** Selected grasps whose label would change. @param {Outcome} outcome */
function changing(outcome) {
  return [...selected.values()].filter((grasp) => grasp.outcome !== outcome);
}

/** Asks before many labels change. @param {Outcome} outcome */
function confirm(outcome) {
  if (!selected.size || run) return;
  wanted = outcome;
  const grasps = changing(outcome);
  if (!grasps.length) return toast(`all selected grasps are ${OUTCOMES[outcome]} already`);
  const counts = LABELS.map(([each]) => [each, grasps.filter((grasp) => grasp.outcome === each).length]);
  const now = counts.filter(([, count]) => count).map(([each, count]) => `${count} ${OUTCOMES[/** @type {Outcome} */ (each)]}`);
  const same = selected.size - grasps.length;
  say(byId("bulk-title"), `${number(grasps.length)} ${grasps.length === 1 ? "grasp" : "grasps"} → ${OUTCOMES[outcome]}`);
  say(byId("bulk-words"), `Labels now: ${now.join(", ")}${same ? `; ${same} more have this label already` : ""}. Each is one step for “Undo”.`);
  const dialog = byId("bulk-dialog");
  dialog.returnValue = "";
  dialog.showModal();
}

/** Labels one after the other and ends at the first failure: the session saves one at a time. @param {Outcome} outcome */
async function label(outcome) {
  const grasps = changing(outcome);
  run = { done: 0, all: grasps.length, stop: false };
  let failure = "";
  for (const { id } of grasps) {
    if (run.stop) {
      failure = "stopped";
      break;
    }
    failure = await labelOne(id, outcome);
    if (failure) break;
    selected.delete(id);
    run = { ...run, done: run.done + 1 };
    drawBulk();
  }
  const { done, all } = run;
  run = null;
  changed();
  reload();
  if (failure) toast(`${number(done)} of ${number(all)} labelled; the others are unchanged: ${failure}`, "error");
  else toast(`${number(done)} labelled ${OUTCOMES[outcome]}`);
}

/** Returns why it failed, or nothing. @param {string} id @param {Outcome} outcome */
async function labelOne(id, outcome) {
  try {
    const answer = await change("POST", `api/grasps/${encodeURIComponent(id)}/label`, { outcome });
    return answer.result === "accepted" ? "" : `grasp ${short(id)}: ${failureReason(answer)}`;
  } catch (error) {
    return `grasp ${short(id)}: ${/** @type {Error} */ (error).message}`;
  }
}

/**
 * @param {() => GraspSummary[]} list the loaded grasps
 * @param {() => void} redraw called after a change of the selection
 * @param {() => void} load called after a run
 */
export function startBulk(list, redraw, load) {
  shown = list;
  changed = redraw;
  reload = load;
  byId("select").addEventListener("click", () => {
    if (selecting) return run ? undefined : finish();
    selecting = true;
    changed();
  });
  const dialog = byId("bulk-dialog");
  dialog.addEventListener("close", () => {
    if (dialog.returnValue === "ok") label(wanted);
  });
}
