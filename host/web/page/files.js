// Finds the files of one session among those that a person drops or chooses.

const MOST_BYTES = 256 * 2 ** 20;
const SESSION = 'session.toml';

/** Files of a zip archive, stored or deflated. */
async function unzip(name, data) {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  let end = data.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end -= 1;
  if (end < 0) throw new Error(`${name}: no zip archive, or it is cut off`);
  const decoder = new TextDecoder();
  let at = view.getUint32(end + 16, true);
  let total = 0;
  const files = [];
  for (let count = view.getUint16(end + 10, true); count > 0; count -= 1) {
    if (at + 46 > data.length || view.getUint32(at, true) !== 0x02014b50) throw new Error(`${name}: the archive's directory is damaged`);
    const [method, packed, size] = [view.getUint16(at + 10, true), view.getUint32(at + 20, true), view.getUint32(at + 24, true)];
    const [nameLength, extra, comment] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    const path = decoder.decode(data.subarray(at + 46, at + 46 + nameLength));
    const local = view.getUint32(at + 42, true);
    at += 46 + nameLength + extra + comment;
    if (path.endsWith('/')) continue;
    total += size;
    if (total > MOST_BYTES) throw new Error(`${name}: more than ${MOST_BYTES / 2 ** 20} MB when unpacked, expected a smaller session`);
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const part = data.subarray(start, start + packed);
    if (method === 0) {
      files.push([path, part.slice()]);
    } else if (method === 8) {
      const stream = new Blob([part]).stream().pipeThrough(new DecompressionStream('deflate-raw'));
      files.push([path, new Uint8Array(await new Response(stream).arrayBuffer())]);
    } else {
      throw new Error(`${name}: ${path} is compressed in a way that is not supported (method ${method}), expected deflate`);
    }
  }
  return files;
}

/** All files in the dropped files and folders. */
async function dropped(items) {
  const found = [];
  const walk = async (entry, prefix) => {
    if (entry.isFile) {
      found.push([prefix + entry.name, await new Promise((resolve, reject) => entry.file(resolve, reject))]);
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const part = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (part.length === 0) return;
      for (const one of part) await walk(one, `${prefix}${entry.name}/`);
    }
  };
  const entries = [...items].map((item) => item.webkitGetAsEntry && item.webkitGetAsEntry()).filter(Boolean);
  for (const entry of entries) await walk(entry, '');
  return found;
}

/** The files of the session among these: its folder's name goes before every path, as on the command line. */
async function sessionOf(chosen) {
  const total = chosen.reduce((sum, [, file]) => sum + file.size, 0);
  if (total > MOST_BYTES) {
    throw new Error(`${Math.round(total / 2 ** 20)} MB is too much for a browser, expected at most ${MOST_BYTES / 2 ** 20} MB: use guide on the command line`);
  }
  let all = [];
  let name = 'session';
  for (const [path, file] of chosen) {
    const data = new Uint8Array(await file.arrayBuffer());
    if (/\.zip$/i.test(path)) {
      name = path.replace(/^.*\//, '').replace(/\.zip$/i, '');
      all = all.concat(await unzip(path, data));
    } else {
      all.push([path, data]);
    }
  }
  const roots = all.map(([path]) => path).filter((path) => path === SESSION || path.endsWith(`/${SESSION}`));
  if (roots.length === 0) {
    const hint = chosen.some(([path]) => /\.mcap$/i.test(path)) ? ' (a recording becomes one with guide export)' : '';
    throw new Error(`no ${SESSION} among ${all.length} ${all.length === 1 ? 'file' : 'files'}, expected the folder of a session${hint}`);
  }
  roots.sort((a, b) => a.length - b.length);
  const root = roots[0].slice(0, -SESSION.length);
  const folder = root.split('/').filter(Boolean).pop() || name;
  const inside = all.filter(([path]) => path.startsWith(root));
  return { name: folder, files: inside.map(([path, data]) => [`${folder}/${path.slice(root.length)}`, data]) };
}
