/**
 * The page: draws the server's state and keeps none of its own.
 *
 * @import {State} from "./types.js"
 */
import { askLost, drawActions, startActions } from "./actions.js";
import { abandonChanges, version, watchConnection } from "./api.js";
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
import { drawRecent, goLive, startRecent } from "./recent.js";
import { forgetClock, noteClock } from "./sender.js";
import { play, startSound } from "./sound.js";

/** Age of the state after which its prediction is hidden and no command is sent, ms. */
const STATE_TIMEOUT_MS = 1500;

/** @type {State|null} */
let state = null;
let receivedAt = 0;
/** Reason why the server is not connected; null while it is. @type {string|null} */
let offline = "not connected";
let wasLinked = false;
/** Version of the server that this page belongs to. @type {string|null} */
let loadedVersion = null;
const images = new Images();
const reader = new Reader();

function draw() {
  drawActions(state?.session ?? null, staleReason());
  if (!state) return;
  drawSteps(state.session);
  reader.note(state.session, drawGauge(state, staleReason()));
  drawLabels(state, openDetail);
  drawCameras(state);
  images.draw(state);
  drawRecent(state.session);
}

/** Reason why the newest state is out of date. */
function staleReason() {
  if (offline) return offline;
  return performance.now() - receivedAt > STATE_TIMEOUT_MS ? "no data from gripcast" : null;
}

/** @param {string} text empty to close it */
function linkBanner(text) {
  const box = byId("link");
  box.hidden = !text;
  say(box, text);
}

/** @param {State} now */
function received(now) {
  // The state of an answer may overtake an older one of the event connection.
  if (offline === null && state && now.monotonic_ms < state.monotonic_ms) return;
  noteClock(now);
  state = now;
  receivedAt = performance.now();
  draw();
}

const link = new Link({
  state: received,
  tone: play,
  stored: galleryChanged,
  linked(hasEvents) {
    offline = null;
    wasLinked = true;
    document.body.classList.remove("offline", "locked");
    byId("login").hidden = true;
    linkBanner(
      hasEvents
        ? ""
        : "WebSocket blocked: the state is fetched every 0.4 s, without tones. A proxy must pass the headers Upgrade and Connection.",
    );
    draw();
    view();
    galleryChanged();
    askLost();
    reloadAfterUpdate();
    drawLogout();
  },
  lost(isShutdown, reason) {
    offline = isShutdown ? "gripcast has stopped" : wasLinked ? "connection lost" : "not connected";
    document.body.classList.add("offline");
    linkBanner(lostWords(isShutdown, reason));
    forgetClock();
    abandonChanges();
    images.stop();
    draw();
  },
  locked() {
    images.stop();
    offline = "log in first";
    linkBanner("");
    document.body.classList.add("locked");
    askToken();
  },
});

/** @param {boolean} isShutdown @param {string|null} reason why the server refuses this page */
function lostWords(isShutdown, reason) {
  if (reason) return `Not connected: ${reason}`;
  if (isShutdown) return "gripcast has stopped. All saved grasps are safe. This page reconnects when gripcast is restarted.";
  if (wasLinked) return "Connection lost; all saved grasps are safe. Reconnecting …";
  return "Not connected: gripcast does not respond. Trying again …";
}

/** Reloads the page after an update of gripcast. */
async function reloadAfterUpdate() {
  try {
    const now = await version();
    if (loadedVersion && now && now !== loadedVersion) location.reload();
    loadedVersion = now ?? loadedVersion;
    say(byId("version"), loadedVersion ? `gripcast ${loadedVersion}` : "");
  } catch {
    // Checked again at the next connection.
  }
}

/** Shows the view of the address; images load only while visible. */
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
  const visible = !grasps && !document.hidden && offline === null;
  if (!visible) goLive();
  if (visible && !images.running) images.start();
  else if (!visible) images.stop();
}

/** Keeps the screen on; browsers allow this on secure pages. */
async function stayAwake() {
  if (document.hidden) return;
  try {
    await navigator.wakeLock?.request("screen");
  } catch {
    // The screen keeps its own setting.
  }
}

watchConnection(staleReason);
startActions(received);
startDetail();
startGallery();
startKeys();
startNames();
startSound();
startRecent(() => images.tiles.values());
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
// Without new states the prediction and the buttons go.
setInterval(() => {
  if (!state) return;
  drawGauge(state, staleReason());
  drawActions(state.session, staleReason());
}, 500);
stayAwake();
await loginFromAddress();
view();
link.start();
