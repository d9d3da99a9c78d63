/**
 * List of the saved grasps, newest first, by outcome, object and date.
 *
 * @import {GraspSummary, Outcome} from "./types.js"
 */
import { address, change, get, failureReason } from "./api.js";
import { drawBulk, isLabelling, isSelected, isSelecting, startBulk, toggleSelected, updateSelected } from "./bulk.js";
import { openDetail, refreshDetail } from "./detail.js";
import { button, byId, make, refill, say, toast } from "./dom.js";
import { markNode, outcomeNode } from "./labels.js";
import { moment, number, OUTCOMES, probability, short } from "./words.js";

const PAGE = 24;
/** Maximum number of grasps in one request. */
const MAX_REQUEST = 500;
/** Delay that merges a burst of changes into one reload, ms. */
const BURST_MS = 250;
/** @type {[string, string, Record<string, string>][]} */
const FILTERS = [
  ["all", "All", {}],
  ["disagree", "Disagreement", { disagree: "true" }],
  ["unlabelled", "Unlabelled", { outcome: "unlabelled" }],
  ["stable", "Stable", { outcome: "stable" }],
  ["slip", "Slip", { outcome: "slip" }],
];

let filter = FILTERS[0];
/** @type {GraspSummary[]} */
let grasps = [];
/** @type {string|null} */
let next = null;
let wanted = PAGE;
let shown = false;
let timer = 0;
/** Number of the newest load; responses of earlier loads are dropped. */
let round = 0;
/** Grasps moved to the trash on this page: id and object. @type {Map<string, string>} */
const trashed = new Map();

/** Query of all filters; dates are days of this browser's time zone, both inclusive. */
function query() {
  const object = byId("object-filter").value;
  const [from, to] = [byId("from-filter").value, byId("to-filter").value].map((day) => (day ? new Date(`${day}T00:00:00`) : null));
  if (to) to.setDate(to.getDate() + 1);
  return new URLSearchParams({
    ...filter[2],
    ...(object ? { object } : {}),
    ...(from ? { since: from.toISOString() } : {}),
    ...(to ? { until: to.toISOString() } : {}),
  });
}

/** Whether any filter is set. */
function isFiltered() {
  return query().size > 0;
}

/** Loads the objects of the dataset with their number of grasps. */
async function loadObjects() {
  try {
    const { objects, target_per_object: target } = await get("api/objects");
    const select = byId("object-filter");
    const chosen = select.value;
    refill(select, [objects, target], () => [
      option("", "all objects"),
      ...objects.map((/** @type {import("./types.js").ObjectCounts} */ each) => {
        const labelled = each.stable + each.slip;
        const count = target ? `${number(labelled)} of ${number(target)}` : number(labelled + each.unlabelled);
        return option(each.object, `${each.object || "no object"} · ${count}`);
      }),
    ]);
    select.value = chosen;
    if (select.value !== chosen) select.value = "";
  } catch {
    // The filter offers what was loaded before.
  }
}

/** @param {string} value @param {string} text */
function option(value, text) {
  const node = make("option", "", text);
  node.value = value;
  return node;
}

/** Reloads the list. */
async function load() {
  loadObjects();
  const mine = (round += 1);
  try {
    /** @type {GraspSummary[]} */
    const found = [];
    let before = null;
    do {
      const page = await get(`api/grasps?${new URLSearchParams([
        ...query(),
        ["limit", String(Math.min(wanted - found.length, MAX_REQUEST))],
        ...(before ? [["before", before]] : []),
      ])}`);
      if (mine !== round) return;
      found.push(...page.grasps);
      before = page.next;
    } while (before && found.length < wanted);
    grasps = found;
    next = before;
    updateSelected(grasps);
    draw();
  } catch (error) {
    if (mine === round) say(byId("gallery-note"), `cannot load the list: ${/** @type {Error} */ (error).message}`);
  }
}

function draw() {
  for (const { id } of grasps) trashed.delete(id);
  drawTrashed();
  drawBulk();
  const none = isFiltered() ? "no matching grasp" : "no grasp yet";
  say(byId("gallery-note"), grasps.length ? "" : none);
  byId("more").hidden = !next;
  const list = byId("gallery");
  /** @type {Map<string, any>} */
  const cards = new Map([...list.children].map((card) => [card.dataset.id, card]));
  const wantedCards = grasps.map((grasp) => {
    const card = cards.get(grasp.id) ?? make("li");
    card.dataset.id = grasp.id;
    refill(card, [grasp, isSelecting(), isSelected(grasp.id)], () => [cardButton(grasp)]);
    return card;
  });
  // Unchanged cards stay in place, so that images stay loaded and the focus is kept.
  const kept = new Set(wantedCards);
  for (const card of [...list.children]) if (!kept.has(card)) card.remove();
  wantedCards.forEach((card, index) => {
    if (list.children[index] !== card) list.insertBefore(card, list.children[index] ?? null);
  });
}

/** @param {GraspSummary} grasp */
function cardButton(grasp) {
  const mark = { true: "✓", false: "✗", null: "" }[String(grasp.agrees)] ?? "";
  const node = button("", () => (isSelecting() ? toggleSelected(grasp) : openDetail(grasp.id)), "card");
  if (isSelecting()) node.setAttribute("aria-pressed", String(isSelected(grasp.id)));
  const p = grasp.prediction ? probability(grasp.prediction) : undefined;
  const said = p === undefined ? "no prediction" : `predicted ${p.toFixed(2)}`;
  node.setAttribute("aria-label", `grasp ${short(grasp.id)}, ${grasp.object || "no object"}, ${OUTCOMES[grasp.outcome]}, ${said}${mark === "✗" ? ", disagree" : ""}`);
  const images = make("span", "thumbs", ...thumbs(grasp));
  const line = make("span", "line", outcomeNode(grasp.outcome), make("span", "faint", ` ${said} `));
  if (mark) line.append(markNode(mark));
  node.append(
    images,
    make("span", "line object", grasp.object || "no object"),
    line,
    make("span", "line faint", `${short(grasp.id)} · ${moment(grasp.captured_at)}`),
  );
  return node;
}

/** Thumbnails: both tactile differences and the colour image. @param {GraspSummary} grasp */
function thumbs({ id, roles }) {
  const wantedThumbs = [
    ["left", "difference"],
    ["right", "difference"],
    ["rgb", "grasp"],
  ];
  return wantedThumbs
    .filter(([role]) => roles.includes(/** @type {any} */ (role)))
    .map(([role, stage]) => {
      const image = make("img");
      image.loading = "lazy";
      image.alt = "";
      image.src = address(`api/grasps/${encodeURIComponent(id)}/preview/${stage}/${role}.jpg`);
      return image;
    });
}

function drawTrashed() {
  refill(byId("trashed"), [...trashed], () =>
    [...trashed].map(([id, object]) =>
      make("li", "", `grasp ${short(id)} ${object} is in the trash `, button("Restore", () => restore(id))),
    ),
  );
}

/** @param {string} id @param {string} object */
export function noteTrashed(id, object) {
  trashed.set(id, object);
  drawTrashed();
  galleryChanged();
}

/** @param {string} id */
export async function restore(id) {
  try {
    const answer = await change("POST", `api/grasps/${encodeURIComponent(id)}/restore`);
    if (answer.result !== "accepted") return toast(failureReason(answer), "error");
    trashed.delete(id);
    drawTrashed();
    toast(`grasp ${short(id)} restored`);
    galleryChanged();
  } catch (error) {
    toast(`grasp ${short(id)} not restored: ${/** @type {Error} */ (error).message}`, "error");
  }
}

/** Reloads after a possible change of the dataset. */
export function galleryChanged() {
  clearTimeout(timer);
  timer = setTimeout(() => {
    // While many are labelled, the list is loaded once, at the end.
    if (isLabelling()) return;
    refreshDetail();
    if (shown) load();
  }, BURST_MS);
}

/** @param {boolean} visible */
export function showGallery(visible) {
  if (visible && !shown) load();
  shown = visible;
}

export function startGallery() {
  const buttons = FILTERS.map((each) => {
    const node = button(each[1], () => {
      filter = each;
      wanted = PAGE;
      for (const other of buttons) other.setAttribute("aria-pressed", String(other === node));
      load();
    });
    node.dataset.filter = each[0];
    node.setAttribute("aria-pressed", String(each === filter));
    return node;
  });
  byId("outcome-filters").append(...buttons);
  for (const name of ["object-filter", "from-filter", "to-filter"]) {
    byId(name).addEventListener("change", () => {
      wanted = PAGE;
      load();
    });
  }
  startBulk(
    () => grasps,
    draw,
    galleryChanged,
  );
  byId("more").addEventListener("click", () => {
    wanted = grasps.length + PAGE;
    load();
  });
}

/** Neighbours of a grasp in the list. @param {string} id */
export function neighbours(id) {
  const at = grasps.findIndex((grasp) => grasp.id === id);
  return { newer: at > 0 ? grasps[at - 1].id : null, older: at >= 0 ? (grasps[at + 1]?.id ?? null) : null };
}
