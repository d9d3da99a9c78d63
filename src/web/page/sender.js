/**
 * What a command tells the server about itself: its id, its age, and what the operator saw.
 *
 * @import {Seen, State} from "./types.js"
 */

/** Time after which the estimate of the server's clock is replaced, ms: clocks drift apart. */
const ESTIMATE_MS = 30000;

/** Server's clock minus that of this page, ms, and the time of the estimate. */
let offset = -Infinity;
let estimatedAt = -Infinity;

/**
 * Takes the clock of a state. A state that was delayed would make the server's clock late, so the
 * least delayed one of the last seconds counts.
 * @param {State} state
 */
export function noteClock(state) {
  const now = performance.now();
  const found = state.monotonic_ms - now;
  if (found < offset && now - estimatedAt < ESTIMATE_MS) return;
  offset = found;
  estimatedAt = now;
}

/** Forgets the clock: the next connection may be to another boot of the server's machine. */
export function forgetClock() {
  offset = estimatedAt = -Infinity;
}

/** A new id of a command; `randomUUID` needs a secure page. */
export function newId() {
  return [...crypto.getRandomValues(new Uint8Array(12))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * @param {string} request_id
 * @param {number} pressedAt time of the press, `event.timeStamp`
 * @param {Seen} seen
 */
export function sender(request_id, pressedAt, seen) {
  const now = performance.now();
  const sent_at_ms = Number.isFinite(offset) ? now + offset : undefined;
  return { request_id, age_ms: Math.max(0, now - pressedAt), sent_at_ms, seen };
}
