/** Keyboard shortcuts, the same as in the terminal. */
import { command } from "./actions.js";
import { openSensors, minimiseFaults } from "./cameras.js";
import { byId, make, toggle } from "./dom.js";
import { ask, askLastObject } from "./labels.js";

/** @type {[string, string][]} */
const HELP = [
  ["space, pedal", "next step: initial frame, then grasp frame"],
  ["i", "take the initial frame (again)"],
  ["g", "take the grasp frame"],
  ["s", "label the last grasp stable"],
  ["f", "label the last grasp slip (slipped or fell)"],
  ["u", "undo the last step (again for more)"],
  ["r", "redo what was undone"],
  ["!", "override a refusal; recorded with the grasp"],
  ["o", "set the object name"],
  ["e", "correct the object of the last grasp"],
  ["n", "set the scene name"],
  ["p", "set the operator name"],
  ["h", "sensors in detail"],
  ["l", "show or leave the list of grasps"],
  ["Esc", "close a panel, minimise a fault"],
  ["Tab, Enter", "select a button, press it"],
];

/** @type {Record<string, string>} */
const COMMANDS = { " ": "trigger", i: "initial", g: "grasp", s: "stable", f: "slip", u: "undo", r: "redo", "!": "override" };

/** @type {Record<string, () => void>} */
const PANELS = {
  o: () => ask("object"),
  e: askLastObject,
  n: () => ask("scene"),
  p: () => ask("operator"),
  h: openSensors,
  l: () => {
    location.hash = location.hash === "#grasps" ? "#collect" : "#grasps";
  },
  "?": () => toggle(byId("help-dialog")),
  escape: minimiseFaults,
};

/** Maximum interval of the presses that a held key, or a bouncing pedal, makes, ms. */
const REPEAT_MS = 150;

/** Time of the newest press by key. @type {Map<string, number>} */
const pressedAt = new Map();

/** Whether a press is the repetition of a held key; remote desktops do not mark it. @param {string} key @param {KeyboardEvent} event */
function isRepeat(key, event) {
  const before = pressedAt.get(key);
  pressedAt.set(key, event.timeStamp);
  return event.repeat || (before !== undefined && event.timeStamp - before < REPEAT_MS);
}

/** @param {KeyboardEvent} event */
function press(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.isComposing || event.defaultPrevented) return;
  const target = /** @type {HTMLElement} */ (event.target);
  // The field of a panel that has just closed keeps the focus until the next frame.
  if (target.matches("input, select, textarea") && target.checkVisibility()) return;
  const key = event.key.toLowerCase();
  // Space and Enter press the focused button.
  if ((key === " " || key === "enter") && target.closest("button, a, summary")) return;
  const dialog = document.querySelector("dialog[open]");
  if (dialog && !permitted(dialog, key, event)) return;
  const text = COMMANDS[key];
  const panel = PANELS[key];
  if (!text && !panel) return;
  if (key !== "escape") event.preventDefault();
  // A key that is held down sends one command.
  if (isRepeat(key, event)) return;
  if (text) command(text, event.timeStamp);
  else panel();
}

/** An open panel accepts its own key only; the help panel accepts every command.
 * @param {Element} dialog @param {string} key @param {Event} event */
function permitted(dialog, key, event) {
  if (dialog.id === "sensors-dialog" && key === "h") {
    event.preventDefault();
    byId("sensors-dialog").close();
    return false;
  }
  return dialog.id === "help-dialog" && (key in COMMANDS || key === "?");
}

export function startKeys() {
  byId("keys").append(...HELP.flatMap(([key, meaning]) => [make("dt", "", make("kbd", "", key)), make("dd", "", meaning)]));
  addEventListener("keydown", press);
  byId("show-keys").addEventListener("click", () => byId("help-dialog").showModal());
  for (const dialog of document.querySelectorAll("dialog")) {
    for (const close of dialog.querySelectorAll("button.close")) close.addEventListener("click", () => dialog.close());
    // A click outside a panel closes it.
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  }
}
