/**
 * One grasp: images, label, prediction, relabelling and trash.
 *
 * @import {Outcome, Role} from "./types.js"
 */
import { address, ApiError, change, get, failureReason } from "./api.js";
import { button, byId, make, refill, say, toast } from "./dom.js";
import { neighbours, noteTrashed, restore } from "./gallery.js";
import { askEdit, markNode, outcomeNode } from "./labels.js";
import { adaptationWords, agreement, moment, probability, short } from "./words.js";

/** @type {Role[]} */
const ROLES = ["left", "right", "rgb", "depth", "external"];
/** @type {string|null} */
let open = null;
/** Whether a change is pending; one at a time. */
let busy = false;

/** @param {string} id */
export async function openDetail(id) {
  open = id;
  const dialog = byId("detail-dialog");
  if (!dialog.open) {
    say(byId("detail-title"), `grasp ${short(id)}`);
    refill(byId("detail"), id, () => []);
    dialog.showModal();
  }
  await refreshDetail();
}

/** Reloads and draws the open grasp. */
export async function refreshDetail() {
  const id = open;
  if (!id || !byId("detail-dialog").open) return;
  try {
    const record = await get(`api/grasps/${encodeURIComponent(id)}`);
    if (id === open) draw(record);
  } catch (error) {
    if (id === open) drawMissing(id, /** @type {Error} */ (error));
  }
}

/** @param {string} id @param {Error} error */
function drawMissing(id, error) {
  const trashed = error instanceof ApiError && error.status === 404;
  refill(byId("detail"), [id, error.message], () => [
    make("p", "", trashed ? "This grasp is not in the dataset; it may be in the trash." : error.message),
    ...(trashed ? [button("Restore from trash", () => restore(id), "primary")] : []),
  ]);
}

/** @param {any} record grasp.json */
function draw(record) {
  const { id, outcome } = record;
  const sides = neighbours(id);
  const words = [record.object || "no object", moment(record.grasp?.captured_at ?? "")];
  say(byId("detail-title"), `grasp ${short(id)} · ${words.join(" · ")}`);
  refill(byId("detail"), [record, sides], () => [
    verdict(record),
    images(record),
    make(
      "div",
      "detail-buttons",
      labelButton(id, outcome, "stable", "Stable"),
      labelButton(id, outcome, "slip", "Slip"),
      labelButton(id, outcome, "unlabelled", "No label"),
      button("Move to trash", () => trash(id, record.object ?? ""), "danger"),
    ),
    facts(record),
    make("div", "detail-buttons sides", sideButton("← newer", sides.newer), sideButton("older →", sides.older)),
  ]);
}

/** @param {any} record */
function verdict({ outcome, prediction }) {
  const line = make("p", "detail-verdict", outcomeNode(outcome));
  if (!prediction) {
    line.append(make("span", "faint", " · no prediction"));
    return line;
  }
  line.append(make("span", "faint", ` · predicted ${probability(prediction).toFixed(2)} against ${prediction.threshold.toFixed(2)} `));
  const adapted = adaptationWords(prediction);
  if (adapted) line.append(make("span", "faint", `(${adapted}) `));
  const mark = agreement(prediction, outcome);
  if (mark) line.append(markNode(mark));
  return line;
}

/** One row per camera: initial, grasp and tactile difference. @param {any} record */
function images({ id, initial, grasp }) {
  const roles = ROLES.filter((role) => initial?.cameras?.[role] || grasp?.cameras?.[role]);
  const box = make("div", "detail-images");
  for (const role of roles) {
    const gel = role === "left" || role === "right";
    const stages = [
      ["initial", initial?.cameras?.[role]],
      ["grasp", grasp?.cameras?.[role]],
      ["difference", gel && initial?.cameras?.[role] && grasp?.cameras?.[role]],
    ];
    const row = make("div", "row");
    for (const [stage, camera] of stages) if (camera) row.append(image(id, role, stage, camera.file, row.children.length === 0));
    box.append(row);
  }
  return box;
}

/** @param {string} id @param {string} role @param {string} stage @param {string|undefined} file
 * @param {boolean} first whether its caption names the camera, for the whole row */
function image(id, role, stage, file, first) {
  const base = `api/grasps/${encodeURIComponent(id)}`;
  const image = make("img");
  image.src = address(`${base}/preview/${stage}/${role}.jpg`);
  image.alt = `${role}, ${stage}`;
  image.loading = "lazy";
  const caption = make("figcaption", "", make("b", "", first ? `${role} ` : ""), stage);
  if (!file) return make("figure", "", caption, image);
  const link = make("a", "", image);
  link.href = address(`${base}/files/${encodeURIComponent(file)}`);
  link.target = "_blank";
  link.rel = "noopener";
  link.title = "original file";
  return make("figure", "", caption, link);
}

/** @param {any} record */
function facts(record) {
  const guards = (record.overridden_guards ?? []).map((/** @type {any} */ each) => `${each.stage}: ${each.reason}`);
  const pairs = [
    ["id", record.id],
    ["object", record.object],
    ["scene", record.scene],
    ["operator", record.operator],
    ["labelled", record.labelled_at && moment(record.labelled_at)],
    ["model", record.prediction?.model],
    ["skew", record.grasp?.skew_ms !== undefined && `${Number(record.grasp.skew_ms).toFixed(0)} ms`],
    ["overridden guards", guards.join("; ")],
    ["note", record.note],
  ];
  const list = make("dl", "facts");
  for (const [name, value] of pairs) {
    const editable = name === "object" || name === "scene" || name === "operator";
    if (!value && !editable) continue;
    const edit = editable ? [" ", editButton(record.id, name, value ?? "")] : [];
    list.append(make("dt", "", name), make("dd", "", String(value || "–"), ...edit));
  }
  return list;
}

/** @param {string} id @param {"object"|"scene"|"operator"} field @param {string} now */
function editButton(id, field, now) {
  const node = button("Edit", () => askEdit(id, field, now), "link");
  node.setAttribute("aria-label", `edit ${field}`);
  return node;
}

/** @param {string} id @param {Outcome} now @param {Outcome} outcome @param {string} text */
function labelButton(id, now, outcome, text) {
  const node = button(text, () => alter(`api/grasps/${encodeURIComponent(id)}/label`, { outcome }, "not labelled"), outcome);
  node.setAttribute("aria-pressed", String(now === outcome));
  return node;
}

/** @param {string} text @param {string|null} id */
function sideButton(text, id) {
  const node = button(text, () => id && openDetail(id));
  if (!id) node.setAttribute("aria-disabled", "true");
  return node;
}

/** @param {string} id @param {string} object */
async function trash(id, object) {
  if (await alter(`api/grasps/${encodeURIComponent(id)}/trash`, undefined, "not moved to trash")) noteTrashed(id, object);
}

/** @param {string} path @param {object|undefined} body @param {string} failure */
async function alter(path, body, failure) {
  if (busy) return false;
  busy = true;
  try {
    const answer = await change("POST", path, body);
    if (answer.result !== "accepted") toast(`${failure}: ${failureReason(answer)}`, "error");
    await refreshDetail();
    return answer.result === "accepted";
  } catch (error) {
    toast(`${failure}: ${/** @type {Error} */ (error).message}`, "error");
    return false;
  } finally {
    busy = false;
  }
}

export function startDetail() {
  const dialog = byId("detail-dialog");
  dialog.addEventListener("close", () => {
    open = null;
  });
  dialog.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    const sides = open ? neighbours(open) : { newer: null, older: null };
    const id = event.key === "ArrowLeft" ? sides.newer : event.key === "ArrowRight" ? sides.older : null;
    if (id) openDetail(id);
  });
}
