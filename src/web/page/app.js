/**
 * The page: state comes from the server, goes to the parts, and nothing is kept between.
 *
 * @import {State} from "./types.js"
 */
import { drawActions, startActions } from "./actions.js";
import { version } from "./api.js";
import { drawCameras } from "./cameras.js";
import { startDetail, openDetail } from "./detail.js";
import { byId, say } from "./dom.js";
import { galleryChanged, showGallery, startGallery } from "./gallery.js";
import { drawGauge, drawSteps, Reader } from "./gauge.js";
import { startKeys } from "./keys.js";
import { drawLabels, startNames } from "./labels.js";
import { Link } from "./link.js";
import { askToken, drawLogout, loginFromAddress, startLogin, startLogout } from "./login.js";
import { Images } from "./images.js";
import { play, startSound } from "./sound.js";

/** After this long without news a prediction is no longer one, ms. */
const NEWS_MS = 1500;

/** @type {State|null} */
let state = null;
let heard = 0;
/** Why the server cannot be reached; null while it can. @type {string|null} */
let cut = "connecting …";
/** @type {string|null} */
let known = null;
const images = new Images();
const reader = new Reader();

function draw() {
  drawActions(state?.session ?? null, cut === null);
  if (!state) return;
  drawSteps(state.session);
  reader.note(state.session, drawGauge(state, silence()));
  drawLabels(state, openDetail);
  drawCameras(state);
  images.draw(state);
}

/** Why the newest state says nothing about this moment. */
function silence() {
  if (cut) return cut;
  return performance.now() - heard > NEWS_MS ? "no news from gripcast" : null;
}

/** @param {string} text empty to close it */
function linkBanner(text) {
  const box = byId("link");
  box.hidden = !text;
  say(box, text);
}

const link = new Link({
  state(now) {
    state = now;
    heard = performance.now();
    draw();
  },
  tone: play,
  stored: galleryChanged,
  linked() {
    cut = null;
    document.body.classList.remove("cut", "locked");
    byId("login").hidden = true;
    linkBanner("");
    draw();
    view();
    galleryChanged();
    reloadAfterUpdate();
    drawLogout();
  },
  lost(bye) {
    cut = bye ? "gripcast has stopped" : "connection lost";
    document.body.classList.add("cut");
    linkBanner(
      bye
        ? "gripcast was stopped. All saved grasps are safe. This page goes on when it is started again."
        : "Connection lost, saved grasps are safe. Trying again …",
    );
    images.stop();
    draw();
  },
  locked() {
    images.stop();
    cut = "log in first";
    linkBanner("");
    document.body.classList.add("locked");
    askToken();
  },
});

/** A newer gripcast brings a newer page. */
async function reloadAfterUpdate() {
  try {
    const now = await version();
    if (known && now && now !== known) location.reload();
    known = now ?? known;
    say(byId("version"), known ? `gripcast ${known}` : "");
  } catch {
    // The next link tells.
  }
}

/** Shows the view that the address names; images run only where they are seen. */
function view() {
  const grasps = location.hash === "#grasps";
  byId("collect").hidden = grasps;
  byId("grasps").hidden = !grasps;
  document.body.classList.toggle("browsing", grasps);
  for (const anchor of document.querySelectorAll("nav a")) {
    if ((anchor.getAttribute("href") === "#grasps") === grasps) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  showGallery(grasps);
  const seen = !grasps && !document.hidden && cut === null;
  if (seen && !images.running) images.start();
  else if (!seen) images.stop();
}

/** A screen that is propped on the table shall not go dark. Browsers allow it on secure pages. */
async function stayAwake() {
  if (document.hidden) return;
  try {
    await navigator.wakeLock?.request("screen");
  } catch {
    // The screen's own setting holds.
  }
}

startActions();
startDetail();
startGallery();
startKeys();
startNames();
startSound();
startLogin(() => link.start());
startLogout();
addEventListener("hashchange", async () => {
  if (location.hash.startsWith("#token=")) {
    await loginFromAddress();
    link.start();
  }
  view();
});
document.addEventListener("visibilitychange", () => {
  view();
  stayAwake();
});
setInterval(() => state && drawGauge(state, silence()), 1000);
stayAwake();
await loginFromAddress();
view();
link.start();
