/** Requests to the server. @import {CommandAnswer, State} from "./types.js" */

/** Longest wait for an answer; a save forces files to a disk that may be slow. */
const PATIENCE_MS = 30000;

/** What the server answered instead of what was asked for. */
export class ApiError extends Error {
  /** @param {number} status 0 where no answer came @param {string} what @param {string|null} remedy */
  constructor(status, what, remedy = null) {
    super(remedy ? `${what}: ${remedy}` : what);
    this.status = status;
  }
}

/** Address below the page's own, so that the page may live behind a prefix. @param {string} path */
export function address(path) {
  return new URL(path, document.baseURI).href;
}

/** @param {string} method @param {string} path @param {object} [body] @param {number} [patience_ms] */
async function send(method, path, body, patience_ms = PATIENCE_MS) {
  try {
    const response = await fetch(address(path), {
      method,
      cache: "no-store",
      signal: AbortSignal.timeout(patience_ms),
      headers: body ? { "Content-Type": "application/json" } : {},
      body: body && JSON.stringify(body),
    });
    return { response, answer: await response.json().catch(() => null) };
  } catch {
    throw new ApiError(0, "no answer from gripcast");
  }
}

/** @param {Response} response @param {any} answer */
function refusal(response, answer) {
  const error = answer?.error;
  const where = error?.where ? ` (${error.where})` : "";
  return new ApiError(response.status, error ? `${error.what}${where}` : `HTTP ${response.status}`, error?.remedy ?? null);
}

/** What lies at a path. @param {string} path @param {number} [patience_ms] @returns {Promise<any>} */
export async function get(path, patience_ms) {
  const { response, answer } = await send("GET", path, undefined, patience_ms);
  if (!response.ok || answer === null) throw refusal(response, answer);
  return answer;
}

/** The version of the server, which tells it even when it is not well. @returns {Promise<string|null>} */
export async function version() {
  const { answer } = await send("GET", "api/health", undefined, 5000);
  return answer?.version ?? null;
}

/**
 * Asks for a change. A refusal is an answer, not an error.
 * @param {string} method @param {string} path @param {object} [body]
 * @returns {Promise<CommandAnswer>}
 */
export async function change(method, path, body) {
  const { response, answer } = await send(method, path, body);
  if (typeof answer?.result === "string") return answer;
  throw refusal(response, answer);
}

/** Why a command was not carried out, in one line. @param {CommandAnswer} answer */
export function whyNot(answer) {
  return answer.error ?? (answer.reasons?.join("; ") || "refused");
}

/** Whether this browser has logged in; the cookie itself cannot be read here. @returns {Promise<boolean>} */
export async function loggedIn() {
  return (await get("api/login", 5000)).logged_in;
}

/** Ends the session, in all windows of this browser. */
export async function logout() {
  const { response, answer } = await send("POST", "api/logout");
  // 401: the session has ended already.
  if (!response.ok && response.status !== 401) throw refusal(response, answer);
}

/** @param {string} token */
export async function login(token) {
  const { response, answer } = await send("POST", "api/login", { token });
  if (!response.ok) throw refusal(response, answer);
}
