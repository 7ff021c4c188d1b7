// The page's state: the session, the view, and the results computed so far.

const state = {
  view: 'start',
  session: null,
  isExample: false,
  folder: null,
  records: null,
  tables: null,
  effects: null,
  results: new Map(),
  choice: {},
};
let engine = null;

const VIEWS = [
  ['start', 'Start', () => true],
  ['play', 'Play', () => true],
  ['session', 'Session', () => state.session],
  ['identify', 'Identify', () => state.session],
  ['diagnose', 'Diagnose', () => state.session],
  ['predict', 'Predict', () => state.session],
  ['plan', 'Plan', () => true],
  ['blocks', 'Blocks', () => true],
  ['population', 'Population', () => true],
  ['tables', 'Import', () => true],
  ['live', 'Live', () => live.isOffered || canWatch()],
];
const DRAW = { start: showStart, play: showPlay, session: showSession, identify: showIdentify, diagnose: showDiagnose, predict: showPredict, plan: showPlan, blocks: showBlocks, population: showPopulation, tables: showTables, live: showLive };

const main = () => document.getElementById('main');

/** The address without its mark, as pairs. */
const readAddress = () => Object.fromEntries(new URLSearchParams(location.hash.slice(1)));

/** Keeps what is chosen in the address, so that a link opens the same view. */
function keepAddress(more = {}) {
  Object.assign(state.choice, more);
  const pairs = { view: state.view, ...(state.isExample ? { session: 'example' } : {}), ...(state.folder === null ? {} : { folder: state.folder || '.' }), ...state.choice };
  const kept = Object.entries(pairs).filter(([, value]) => value !== '' && value !== undefined && value !== null);
  history.replaceState(null, '', `#${new URLSearchParams(kept)}`);
}

function show(view, isUser = true) {
  state.view = view;
  keepAddress();
  showTabs();
  announce(null);
  hideFault();
  main().replaceChildren();
  DRAW[view]();
  if (isUser) main().focus({ preventScroll: true });
  window.scrollTo(0, 0);
}

function showTabs() {
  const offered = VIEWS.filter(([id]) => id !== 'live' || live.isOffered || canWatch());
  const tab = ([id, name, isThere]) => h('li', {}, h('button', {
    type: 'button',
    disabled: !isThere(),
    'aria-current': state.view === id ? 'page' : false,
    onclick: () => show(id),
  }, name));
  document.getElementById('tabs').replaceChildren(...offered.map(tab));
  document.getElementById('session-name').textContent = state.session ? `Session: ${state.session}` : '';
}

/** A line about the work in progress; with `onCancel` it has a button that ends the work. */
function announce(text, onCancel = null) {
  const line = document.getElementById('status');
  line.hidden = text === null;
  line.replaceChildren(...(text === null ? [] : [text, ' ', onCancel ? h('button', { type: 'button', class: 'small', onclick: onCancel }, 'Cancel') : '']));
}

function hideFault() { document.getElementById('fault').hidden = true; }

/** Shows an error, with a button to try again if `again` is given. */
function fail(error, again = null) {
  announce(null);
  if (error instanceof Cancelled) { announce('Cancelled.'); return; }
  const box = document.getElementById('fault');
  const stopped = error instanceof EngineStopped;
  const text = stopped ? `The engine stopped: ${error.message}. It has been started again; your files are still here.` : error.message;
  box.hidden = false;
  box.replaceChildren(h('p', {}, text), h('p', {},
    again ? h('button', { type: 'button', onclick: () => { hideFault(); again(); } }, 'Try again') : '', ' ',
    h('button', { type: 'button', onclick: hideFault }, 'Close')));
}

/** A result of the session, computed once. */
async function result(name, content, what) {
  const key = JSON.stringify([name, content]);
  if (!state.results.has(key)) {
    const cancel = () => engine.cancel(name);
    announce(`${what} ...`, cancel);
    const of = state.session;
    const step = (line) => { if (state.session === of) announce(`${what}: ${line}`, cancel); };
    const pending = engine.request(name, { do: name, dir: state.session, ...content }, step);
    state.results.set(key, pending);
    pending.then(() => announce(null), () => state.results.delete(key));
  }
  return state.results.get(key);
}

/** Runs a view's work; results that arrive after the view was left are dropped. */
async function within(view, work) {
  try {
    await work(() => state.view === view);
  } catch (error) {
    if (state.view === view) fail(error, () => show(view, false));
  }
}

async function openSession({ name, files }, isExample, view, folder = null) {
  announce('Reading the session ...');
  hideFault();
  await engine.open(files);
  state.session = name;
  state.isExample = isExample;
  state.folder = folder;
  // Its files take the place of the tables in their worker.
  if (state.tables) state.tables.isSent = false;
  state.results.clear();
  state.choice = view === state.view ? state.choice : {};
  show(view);
}

function exampleFiles() {
  const encoder = new TextEncoder();
  const all = JSON.parse(document.getElementById('example').textContent);
  return { name: 'example', files: Object.entries(all).map(([name, text]) => [`example/${name}`, encoder.encode(text)]) };
}

const openExample = (view) => openSession(exampleFiles(), true, view).catch((error) => fail(error, () => openExample(view)));

async function openChosen(chosen) {
  try {
    const all = await chosen;
    // Records of many sessions, tables of others, or the files of a session.
    if (all.length > 0 && all.every(([path]) => RECORDS.test(path))) await openRecords(all);
    else if (areTables(all)) await openTables(all);
    else await openSession(await sessionOf(all), false, 'session');
  } catch (error) {
    fail(error);
  }
}

const section = (title, ...children) => h('section', {}, h('h2', {}, title), ...children);

/** Shows the view alone, as a figure of another page, and reports its height to that page once it has a drawing. */
function beginEmbedded() {
  document.body.classList.add('embedded');
  const report = () => {
    if (main().querySelector('.rig, .cell')) window.parent.postMessage({ guide: 'shown', height: document.documentElement.offsetHeight }, '*');
  };
  new ResizeObserver(report).observe(document.body);
}

async function begin() {
  showTabs();
  if (typeof WebAssembly !== 'object' || typeof DecompressionStream !== 'function') {
    fail(new Error('this browser is too old for the page, expected Chromium 80, Firefox 113, Safari 16.4 or newer'));
    return;
  }
  document.getElementById('version').textContent = document.querySelector('meta[name="generator"]').content.replace('guide', 'Version');
  if (isServed()) document.getElementById('network').textContent = 'the page connects to the program guide web on this machine, and to nothing else';
  const { view, session, folder, ...choice } = readAddress();
  state.choice = choice;
  if (choice.embed) beginEmbedded();
  const wanted = VIEWS.some(([id]) => id === view) ? view : 'start';
  if (isServed()) await beginLive();
  engine = new Engine();
  engine.ready.catch((error) => fail(error, () => location.reload()));
  if (session === 'example' && wanted !== 'start') {
    state.view = wanted;
    await openExample(wanted);
  } else if (isServed() && folder && wanted !== 'start') {
    state.view = wanted;
    await openNamed(folder, wanted).catch((error) => { show('start', false); fail(error); });
  } else {
    show(VIEWS.find(([id]) => id === wanted)[2]() ? wanted : 'start', false);
  }
}

window.addEventListener('dragover', (event) => event.preventDefault());
window.addEventListener('drop', (event) => {
  event.preventDefault();
  if (event.dataTransfer.items.length > 0) openChosen(dropped(event.dataTransfer.items));
});
window.addEventListener('hashchange', () => {
  const { view } = readAddress();
  if (view && view !== state.view && VIEWS.some(([id, , isThere]) => id === view && isThere())) show(view);
});
