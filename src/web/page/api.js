/** Requests to the server. @import {CommandResponse} from "./types.js" */

/** Timeout of a request; a save may wait for a slow disk, ms. */
const TIMEOUT_MS = 30000;

/** Error response of the server. */
export class ApiError extends Error {
  /** @param {number} status 0 without a response @param {string} what @param {string|null} remedy */
  constructor(status, what, remedy = null) {
    super(remedy ? `${what}: ${remedy}` : what);
    this.status = status;
  }
}

/** Absolute URL of a path relative to the page, which may have a prefix. @param {string} path */
export function address(path) {
  return new URL(path, document.baseURI).href;
}

/** @param {string} method @param {string} path @param {object} [body] @param {number} [timeout_ms] */
async function send(method, path, body, timeout_ms = TIMEOUT_MS) {
  try {
    const response = await fetch(address(path), {
      method,
      cache: "no-store",
      signal: AbortSignal.timeout(timeout_ms),
      headers: body ? { "Content-Type": "application/json" } : {},
      body: body && JSON.stringify(body),
    });
    return { response, answer: await response.json().catch(() => null) };
  } catch {
    throw new ApiError(0, "no response from gripcast");
  }
}

/** @param {Response} response @param {any} answer */
function errorOf(response, answer) {
  const error = answer?.error;
  const where = error?.where ? ` (${error.where})` : "";
  return new ApiError(response.status, error ? `${error.what}${where}` : `HTTP ${response.status}`, error?.remedy ?? null);
}

/** GET request for JSON. @param {string} path @param {number} [timeout_ms] @returns {Promise<any>} */
export async function get(path, timeout_ms) {
  const { response, answer } = await send("GET", path, undefined, timeout_ms);
  if (!response.ok || answer === null) throw errorOf(response, answer);
  return answer;
}

/** Version of the server, also when it is unhealthy. @returns {Promise<string|null>} */
export async function version() {
  const { answer } = await send("GET", "api/health", undefined, 5000);
  return answer?.version ?? null;
}

/**
 * Request for a change. A refusal is a valid response, not an error.
 * @param {string} method @param {string} path @param {object} [body]
 * @returns {Promise<CommandResponse>}
 */
export async function change(method, path, body) {
  const { response, answer } = await send(method, path, body);
  if (typeof answer?.result === "string") return answer;
  throw errorOf(response, answer);
}

/** Reason why a command was not executed, in one line. @param {CommandResponse} answer */
export function failureReason(answer) {
  return answer.error ?? (answer.reasons?.join("; ") || "refused");
}

/** Whether this browser is logged in; scripts cannot read the cookie. @returns {Promise<boolean>} */
export async function loggedIn() {
  return (await get("api/login", 5000)).logged_in;
}

/** Ends the session in all windows of this browser. */
export async function logout() {
  const { response, answer } = await send("POST", "api/logout");
  // 401: the session has already ended.
  if (!response.ok && response.status !== 401) throw errorOf(response, answer);
}

/** @param {string} token */
export async function login(token) {
  const { response, answer } = await send("POST", "api/login", { token });
  if (!response.ok) throw errorOf(response, answer);
}
