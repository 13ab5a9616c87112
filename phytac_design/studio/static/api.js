// Requests to the studio's own server; addresses are relative to the page's, which holds the token.

export class Refused extends Error {
  constructor(status, body) {
    super(body.error || body.ask || "the studio refused this");
    this.status = status;
    this.ask = body.ask || "";
    this.stale = Boolean(body.stale);
    this.fields = body.fields || {};
  }
}

async function answer(path, options) {
  const reply = await fetch(path, { cache: "no-store", ...options });
  const type = reply.headers.get("content-type") || "";
  const body = type.startsWith("application/json") ? await reply.json() : { error: await reply.text() };
  if (!reply.ok || body.stale) throw new Refused(reply.status, body);
  return body;
}

export const get = path => answer(path, {});

export const post = (path, body, signal) => answer(path, {
  method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body), signal,
});

export function node(tag, set = {}, ...children) {
  const out = document.createElement(tag);
  for (const [key, value] of Object.entries(set)) {
    if (value !== false && value !== null) out.setAttribute(key, value === true ? "" : value);
  }
  out.append(...children);
  return out;
}

export const by = id => document.getElementById(id);

export function show(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (typeof value !== "number") return String(value);
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(2)
    : String(+value.toPrecision(4));
}

// Text whose `names` are set as code.
export const prose = text => text.split("`").map((part, k) => (k % 2 ? node("code", {}, part) : part));
