/** DOM helpers. Texts are set as `textContent` only, because names are not trusted. */

/** Returns the element with this id. @param {string} id @returns {any} */
export function byId(id) {
  const node = document.getElementById(id);
  if (!node) throw new Error(`the page has no #${id}`);
  return node;
}

/**
 * Creates an element.
 * @param {string} tag
 * @param {string} [className]
 * @param {...(Node|string)} children
 * @returns {any}
 */
export function make(tag, className = "", ...children) {
  const node = document.createElement(tag);
  if (className) node.className = className;
  node.append(...children);
  return node;
}

/** @param {string} text @param {(event: MouseEvent) => void} act @param {string} [className] */
export function button(text, act, className = "") {
  const node = make("button", className, text);
  node.type = "button";
  node.addEventListener("click", act);
  return node;
}

/** Sets a text only if it differs, so that updates do not disturb a selection. */
export function say(/** @type {Element} */ node, /** @type {string} */ text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Sets a class only if it differs. */
export function style(/** @type {Element} */ node, /** @type {string} */ className) {
  if (node.className !== className) node.className = className;
}

/** Sets or removes an attribute only if it differs. */
export function attribute(/** @type {Element} */ node, /** @type {string} */ name, /** @type {string|null} */ value) {
  if (value === null) node.removeAttribute(name);
  else if (node.getAttribute(name) !== value) node.setAttribute(name, value);
}

/** @type {WeakMap<Element, string>} */
const drawn = new WeakMap();

/**
 * Replaces the children of `node` if `key` has changed.
 * @param {Element} node
 * @param {unknown} key
 * @param {() => (Node|string)[]} children
 */
export function refill(node, key, children) {
  const text = JSON.stringify(key);
  if (drawn.get(node) === text) return;
  drawn.set(node, text);
  node.replaceChildren(...children());
}

/**
 * Shows a temporary message at the bottom of the page.
 * @param {string} text
 * @param {"info"|"error"} [level]
 * @returns {HTMLElement}
 */
export function toast(text, level = "info") {
  const box = byId("toasts");
  const line = make("p", `toast ${level}`, text);
  line.append(button("✕", () => line.remove(), "quiet"));
  line.querySelector("button").setAttribute("aria-label", "Close");
  box.append(line);
  while (box.children.length > 3) box.firstElementChild.remove();
  setTimeout(() => line.remove(), level === "error" ? 15000 : 6000);
  return line;
}

/** Opens or closes a dialog. @param {HTMLDialogElement} dialog */
export function toggle(dialog) {
  if (dialog.open) dialog.close();
  else dialog.showModal();
}
