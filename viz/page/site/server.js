// What the page asks of the program that serves it.
const SECRET = location.hash.slice(1);

async function asked(name, data) {
  let reply;
  try {
    reply = await fetch("/" + name, { method: "POST", body: JSON.stringify(data ?? null), headers: {
      "Content-Type": "application/json", "X-Magmpm-Secret": SECRET } });
  } catch { throw new Error("The program that serves this page has ended. Start it again: magmpm view SCENE"); }
  if (reply.status === 403) throw new Error("This address is incomplete: open the whole address that `magmpm view` printed, with what follows its #.");
  if (!reply.ok) {
    let words = reply.statusText;
    try { words = (await reply.json()).error; } catch { /* not ours */ }
    throw new Error(words);
  }
  return reply;
}

export const plain = async (name, data) => (await asked(name, data)).json();

// A message with arrays (viz/page/wire.py): its header, with the arrays by name in `arrays`.
export async function packed(name, data) {
  const buffer = await (await asked(name, data)).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  const arrays = {};
  for (const { name: called, kind, count } of header.arrays) {
    arrays[called] = new (kind === "u" ? Uint32Array : Float32Array)(buffer, at, count);
    at += 4 * count;
  }
  return { ...header, arrays };
}
