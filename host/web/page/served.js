// The page as `guide web` serves it: sessions below the program's folder. A page from disk has none of this.

const isServed = () => document.querySelector('meta[name="served"]') !== null;

/** The program's answer to a request of the page. */
async function fetchServed(path) {
  let answer;
  try {
    answer = await fetch(path, { cache: 'no-store' });
  } catch {
    throw new Error('the program guide web does not answer: it has ended; start it again and open the address that it prints');
  }
  if (!answer.ok) throw new Error(`${decodeURIComponent(path)}: guide web answers ${answer.status}: the file is gone, too large or not one of a session`);
  return answer;
}

const addressOf = (path, name) => `file/${[...path.split('/'), name].filter(Boolean).map(encodeURIComponent).join('/')}`;

/** Reads the files of a session of the program's folder, and opens it. */
async function openServed({ path, name, files, bytes }, view) {
  if (bytes > MOST_BYTES) throw new Error(`${name}: ${Math.round(bytes / 2 ** 20)} MB is too much for a browser, expected at most ${MOST_BYTES / 2 ** 20} MB: use guide on the command line`);
  const read = [];
  for (const file of files) {
    announce(`Reading ${name}/${file} ...`);
    read.push([`${name}/${file}`, new Uint8Array(await (await fetchServed(addressOf(path, file))).arrayBuffer())]);
  }
  await openSession({ name, files: read }, false, view, path);
}

const listServed = async () => (await fetchServed('sessions')).json();

/** The sessions as a list of buttons. */
function servedCard() {
  const list = h('ul', { class: 'served', id: 'served' });
  const open = (one) => openServed(one, 'session').catch((error) => fail(error, () => open(one)));
  const fill = async () => {
    const { sessions, more } = await listServed();
    if (!list.isConnected) return;
    list.replaceChildren(...sessions.map((one) => h('li', {}, h('button', { type: 'button', onclick: () => open(one) }, one.path || one.name),
      ` ${one.files.length} files, ${number(one.bytes / 1e6)} MB`)));
    if (sessions.length === 0) list.append(h('li', {}, 'There is none (no folder with a session.toml).'));
    if (more) list.append(h('li', {}, 'There are more: start guide web in a subfolder.'));
  };
  const refresh = () => fill().catch((error) => { if (state.view === 'start') fail(error, refresh); });
  refresh();
  return h('section', { class: 'card' }, h('h2', {}, 'Sessions of the folder'), list,
    h('p', {}, h('button', { type: 'button', class: 'small', onclick: refresh }, 'Read again')));
}

/** Opens the session that the address names. */
async function openNamed(folder, view) {
  const { sessions } = await listServed();
  const found = sessions.find((one) => (one.path || '.') === folder);
  if (!found) throw new Error(`${folder}: no such session in the folder of guide web`);
  await openServed(found, view);
}
