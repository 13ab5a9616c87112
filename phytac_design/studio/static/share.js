// A design as part of an address: base64url of its tables as JSON, after the mark.

const MARK = "#design=";

export function addressPart(data) {
  let bytes = "";
  for (const byte of new TextEncoder().encode(JSON.stringify(data))) bytes += String.fromCharCode(byte);
  return MARK + btoa(bytes).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

// Tables in an address or a part of one; null without the mark.
export function sharedDesign(address) {
  const at = address.indexOf(MARK);
  if (at < 0) return null;
  try {
    const text = atob(address.slice(at + MARK.length).trim().replaceAll("-", "+").replaceAll("_", "/"));
    const data = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(
      Uint8Array.from(text, letter => letter.charCodeAt(0))));
    if (data && typeof data === "object" && !Array.isArray(data)) return data;
  } catch { /* said below */ }
  throw new Error("this address holds no whole design: copy it again, to its end");
}
