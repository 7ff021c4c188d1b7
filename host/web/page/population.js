// Population: statistics over many sessions, from their records.

const RECORDS = /\.jsonl$/i;
/** Labels by which groups can be formed, with their names on the page. */
const GROUPINGS = [['tissue', 'tissue'], ['subject', 'subject'], ['rig', 'rig'], ['needle', 'needle'], ['site', 'site'], ['day', 'day'], ['month', 'month']];

/** Labels that the records in these files have. The engine reports lines that are no record. */
function labelsOf(files) {
  const decoder = new TextDecoder();
  const all = new Set();
  files.flatMap(([, data]) => decoder.decode(data).split('\n')).forEach((line) => {
    try {
      const one = JSON.parse(line);
      if (one.date) all.add('day').add('month');
      GROUPINGS.forEach(([name]) => { if (one[name]) all.add(name); });
    } catch { /* The engine names the place. */ }
  });
  return GROUPINGS.filter(([name]) => all.has(name));
}

function useRecords(name, files) {
  state.records = { name, files };
  delete state.choice.by;
  show('population');
}

async function openRecords(chosen) {
  const total = chosen.reduce((sum, [, file]) => sum + file.size, 0);
  if (total > MOST_BYTES) throw new Error(`${Math.round(total / 2 ** 20)} MB is too much for a browser, expected at most ${MOST_BYTES / 2 ** 20} MB: use guide on the command line`);
  const files = [];
  for (const [path, file] of chosen) files.push([path, new Uint8Array(await file.arrayBuffer())]);
  useRecords(files.map(([path]) => path).join(', '), files);
}

const exampleRecords = () => useRecords('example.jsonl', [['example.jsonl', new TextEncoder().encode(document.getElementById('records').textContent.trim())]]);

/** The record of the session that is open, beside those that are there. */
async function addSession() {
  const of = state.session;
  announce(`Computing the record of ${of} ...`, () => engine.cancel('summarize'));
  const record = await engine.request('summarize', { do: 'summarize', dir: of });
  announce(null);
  // In a folder of its own: a file of records may have the name of the session.
  const line = [`added/${of}.jsonl`, new TextEncoder().encode(`${JSON.stringify(record)}\n`)];
  const others = (state.records?.files ?? []).filter(([path]) => path !== line[0]);
  useRecords([...others, line].map(([path]) => path).join(', '), [...others, line]);
}

function showPopulation() {
  within('population', async (isHere) => {
    const input = h('input', { type: 'file', accept: '.jsonl', multiple: true, class: 'hidden', tabindex: '-1', 'aria-hidden': 'true',
      onchange: () => { if (input.files.length) openChosen([...input.files].map((file) => [file.name, file])); } });
    const sources = h('p', { class: 'bar' },
      h('button', { type: 'button', id: 'use-records', onclick: exampleRecords }, 'Use the example\u2019s records'),
      h('button', { type: 'button', onclick: () => input.click() }, 'Choose files of records'), input,
      state.session ? h('button', { type: 'button', id: 'add-session', onclick: () => addSession().catch((error) => fail(error)) }, `Add ${state.session}`) : null);
    const lead = h('section', { class: 'lead' }, h('h2', {}, 'What do many sessions have in common?'),
      h('p', {}, 'Drop the records of sessions that ', h('code', {}, 'guide summarize'), ' has written (.jsonl) anywhere on this page, or choose them.'), sources);
    main().append(lead);
    if (!state.records) {
      if (state.choice.records !== 'example') return;
      state.records = { name: 'example.jsonl', files: [['example.jsonl', new TextEncoder().encode(document.getElementById('records').textContent.trim())]] };
    }
    const { name, files } = state.records;
    if (name === 'example.jsonl') keepAddress({ records: 'example' });
    const labels = labelsOf(files);
    const wanted = state.choice.by ?? labels[0]?.[0] ?? '';
    const by = labels.some(([label]) => label === wanted) ? wanted : '';
    const pick = h('select', { id: 'population-by', onchange: () => { keepAddress({ by: pick.value || 'all' }); show('population', false); document.getElementById('population-by').focus(); } },
      h('option', { value: '' }, 'all sessions together'), ...labels.map(([label, called]) => h('option', { value: label, selected: label === by }, called)));
    announce('Comparing the sessions ...');
    const { document: found, figures } = await engine.population(files, by ? [by] : []);
    if (!isHere()) return;
    announce(null);
    lead.append(h('p', { id: 'population-counts' }, `${name}: ${found.sessions.given} sessions, ${found.sessions.with_modulus} with a modulus, ${found.sessions.used} used.`));
    const remarks = [...found.listed.map((one) => `${one.session}: ${one.weight > 0 ? 'less weight' : 'not used'}: ${one.reason}`), ...found.warnings];
    main().append(
      section('K by group', h('p', {}, h('label', { for: 'population-by' }, 'Groups by '), pick), groupTable(found)),
      section('Effects that sessions share', sharedList(found)),
      section('Figures', h('div', { class: 'figures' }, ...figures.map(figure))),
      remarks.length ? h('details', {}, h('summary', {}, `Notes: ${remarks.length}`), h('ul', {}, ...remarks.map((text) => h('li', {}, text)))) : '',
      saveBar('population', () => found));
  });
}

function groupTable(found) {
  const names = ['Group', 'Sessions', 'Mean of K, kPa', 'Between sessions, sd of ln K', 'New subject, kPa (95 %)', 'I\u00b2'];
  const row = (one) => h('tr', {}, h('th', { scope: 'row' }, one.group), h('td', {}, one.sessions),
    h('td', {}, h('strong', {}, number(one.k_kpa.value)), ` (${interval(one.k_kpa.ci95)})`),
    h('td', {}, number(one.tau), one.tau_ci95 ? ` (${interval(one.tau_ci95)})` : ''),
    h('td', {}, one.new_subject95_kpa ? interval(one.new_subject95_kpa) : 'not identifiable'), h('td', {}, `${number(one.i_squared_percent)} %`));
  return h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'K by group' }, h('table', { id: 'population-groups' },
    h('thead', {}, h('tr', {}, ...names.map((name) => h('th', { scope: 'col' }, name)))), h('tbody', {}, ...found.groups.map(row))));
}

/** The sessions that share an effect, in words. */
function sharingSessions({ kind, label, group }) {
  if (label === 'all') return `in ${group}`;
  return { shared: `in all sessions of ${label} ${group}`, step: `in the sessions of ${label} ${group} from a date on`, trend: `in the sessions of ${label} ${group}, growing with time` }[kind];
}

function sharedList(found) {
  if (found.shared_effects.length === 0) return h('p', {}, `No effect is shared by the sessions of a rig, needle, tissue or day, or by all sessions (${found.tests} tests).`);
  const one = (effect) => h('li', {}, h('code', {}, effect.effect), ` ${sharingSessions(effect)} (${effect.sessions} sessions): `,
    effect.parameters.map((value) => { const [label, unit] = unitOf(value.name); return `${label} ${number(value.value)} (${interval(value.ci95)}) ${unit}`.trim(); }).join(', '),
    `; log evidence ${signed(effect.log_evidence)}`);
  return h('ul', {}, ...found.shared_effects.map(one));
}
