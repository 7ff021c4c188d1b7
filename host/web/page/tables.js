// Import: tables of other laboratories and programs, the quantity of each column, and the session made of them.

const TABLE = /\.(csv|txt|tsv|dat|asc|lvm|xlsx|xlsm|xlsb|xls|ods|mat|mcap)$/i;
/** Needle and guides, millimetres, with their default values. */
const TABLE_RIG = [['outer_diameter_mm', 'Outer diameter of the needle', 1.27], ['inner_diameter_mm', 'Inner diameter', 1], ['guide2_mm', 'Guide 2, from guide 1', 60], ['entry_mm', 'Surface of the tissue, from guide 1', 70]];
const TABLE_ORIGINS = [['', 'not chosen'], ['guide1', 'guide 1'], ['surface', 'the surface']];

const isSession = ([path]) => path === SESSION || path.endsWith(`/${SESSION}`);
const isHidden = ([path]) => path.split('/').pop().startsWith('.');
/** Whether the files are no session and contain a table. */
const areTables = (chosen) => !chosen.some((one) => isSession(one) || /\.zip$/i.test(one[0])) && chosen.some((one) => TABLE.test(one[0]) && !isHidden(one));

async function openTables(chosen) {
  const tables = chosen.filter((one) => TABLE.test(one[0]) && !isHidden(one));
  const total = tables.reduce((sum, [, file]) => sum + file.size, 0);
  if (total > MOST_BYTES) throw new Error(`${Math.round(total / 2 ** 20)} MB is too much for a browser, expected at most ${MOST_BYTES / 2 ** 20} MB: use guide import table`);
  const files = [];
  for (const [path, file] of tables) files.push([path, new Uint8Array(await file.arrayBuffer())]);
  useTables(files);
}

/** Before any choice, quantities follow from the names and units of the columns. */
function useTables(files) {
  state.tables = { files, maps: null, rig: Object.fromEntries(TABLE_RIG.map(([name, , value]) => [name, value])), options: {} };
  show('tables');
}

/** The force series of the example, as a table of another laboratory. */
function exampleTable() {
  const [path, data] = exampleFiles().files.find(([name]) => name.endsWith('.force.csv'));
  useTables([[path.replace(/^.*\//, ''), data]]);
  state.tables.options.depth_mm = 30;
}

const rigText = (rig) => `[needle]\nyoungs_modulus_gpa = 200.0\n${TABLE_RIG.map(([name]) => `${name === 'guide2_mm' ? '[rig]\n' : ''}${name} = ${rig[name].toFixed(6)}\n`).join('')}`;

/** A word quoted for a shell, if necessary. */
const shellWord = (word) => (/^[\w./:=@%+,#-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** The command line that does the same. */
function tableCommand({ files, options, rig }, { maps }) {
  const given = Object.entries(options).filter(([name, value]) => name !== 'id' && value !== undefined && value !== '');
  const words = ['guide', 'import', 'table', ...files.map(([path]) => path), ...maps.flatMap((map) => ['--map', map]),
    ...given.flatMap(([name, value]) => [`--${name.replaceAll('_', '-')}`, String(value)]), ...(options.id ? ['--id', options.id] : []),
    ...(TABLE_RIG.every(([name, , value]) => rig[name] === value) ? [] : ['--rig', 'rig.toml']), '--out', 'session', '--yes'];
  return words.map(shellWord).join(' ');
}

function showTables() {
  if (!state.tables) exampleTable();
  within('tables', async (isHere) => {
    const tables = state.tables;
    const [mapping, echo, drawn] = ['', '', 'drawn'].map((name) => h('div', { class: name }));
    let answer = null;
    const ask = latest(async () => {
      try {
        const { maps, options, rig } = tables;
        await engine.ready;
        if (!tables.isSent) {
          await engine.lane('tables').send('files', tables.files);
          tables.isSent = true;
        }
        const content = { do: 'table', files: tables.files.map(([path]) => path), maps: maps ?? [], rig: rigText(rig), ...Object.fromEntries(Object.entries(options).filter(([, value]) => value !== undefined && value !== '')) };
        answer = await engine.request('tables', content);
        if (!isHere()) return;
        hideFault();
        draw();
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const field = (name, label, value, change, more = {}) => {
      const input = h('input', { id: `tables-${name}`, type: 'number', step: 'any', value: value ?? '', ...more, onchange: () => change(input.value) });
      return h('div', { class: 'slider' }, h('label', { for: `tables-${name}` }, label), input);
    };
    const option = (name) => (value) => { tables.options[name] = value === '' ? undefined : Number(value); ask(); };
    const choice = (name, label, all) => {
      const select = h('select', { id: `tables-${name}`, onchange: () => { tables.options[name] = select.value || undefined; ask(); } },
        ...all.map(([value, text]) => h('option', { value, selected: value === (tables.options[name] ?? '') }, text)));
      return h('div', { class: 'slider' }, h('label', { for: `tables-${name}` }, label), select);
    };
    const names = tables.files.map(([path]) => path).join(', ');
    main().append(h('div', { class: 'two' },
      h('section', { class: 'controls' }, h('h2', {}, 'Run, needle and rig'),
        field('depth_mm', 'Length of the needle in the tissue, mm', tables.options.depth_mm, option('depth_mm')),
        ...TABLE_RIG.map(([name, label]) => field(name, `${label}, mm`, tables.rig[name], (value) => { if (Number.isFinite(Number(value)) && value !== '') { tables.rig[name] = Number(value); ask(); } })),
        choice('z_from', 'Positions along the needle are measured from', TABLE_ORIGINS),
        field('offset_s', 'Seconds to add to the times of the displacement', tables.options.offset_s, option('offset_s')),
        field('rate_hz', 'Rows per second, if there is no time column', tables.options.rate_hz, option('rate_hz'))),
      h('section', {}, h('h2', {}, `Columns of ${names}`),
        h('p', { class: 'note' }, 'The program recognizes columns by their names and units. Choose the quantities of the others; every column that is used needs a unit.'), mapping, echo, drawn)));
    const draw = () => {
      drawMapping(answer, tables, mapping, ask);
      drawEcho(answer, tables, echo);
      drawn.replaceChildren();
      if (answer.drawn.x.length > 0) {
        const insertion = answer.kind === 'insertion';
        responsive(drawn, () => plot(drawn, { title: 'The imported run', height: 220, x: insertion ? 'insertion depth, mm' : 'displacement of guide 2, mm', y: insertion ? 'tip, mm' : 'force, N',
          series: [{ kind: 'dots', x: answer.drawn.x, y: answer.drawn.y, style: 'a' }] }));
      }
    };
    main().append(saveBar('tables', () => answer));
    await ask();
  });
}

/** A row for every column of numbers: its quantity and unit. */
function drawMapping({ columns, quantities, maps }, tables, into, ask) {
  const chosen = new Map(maps.map((map) => [map.slice(0, map.lastIndexOf('=')), map.slice(map.lastIndexOf('=') + 1)]));
  const unitsOf = Object.fromEntries(quantities.map(({ name, units }) => [name, units]));
  const several = new Set(columns.map(({ file }) => file)).size > 1;
  const rows = columns.map((column, i) => ({ column, i, select: null, unit: null }));
  const change = () => {
    const all = rows.filter(({ select }) => select.value).map(({ column, select, unit }) => `${column.name}=${select.value}${unit.value.trim() ? `:${unit.value.trim()}` : ''}`);
    tables.maps = [...new Set(all)];
    ask();
  };
  const body = rows.map((row) => {
    const { column, i } = row;
    const [quantity, unit] = (chosen.get(column.name) ?? '').split(':');
    row.select = h('select', { id: `tables-column-${i}`, 'aria-label': `Quantity of ${column.name}`, onchange: change },
      h('option', { value: '' }, 'not used'), ...quantities.map(({ name }) => h('option', { value: name, selected: name === quantity }, name)));
    row.unit = h('input', { id: `tables-unit-${i}`, type: 'text', size: 8, 'aria-label': `Unit of ${column.name}`, value: unit ?? '', placeholder: column.is_stamp ? 'date or time' : column.unit ?? unitsOf[quantity] ?? '', disabled: column.is_stamp, onchange: change });
    return h('tr', {}, ...(several ? [h('td', {}, column.file)] : []), h('th', { scope: 'row' }, column.name), h('td', {}, row.select), h('td', {}, row.unit), h('td', {}, column.values.map((value) => number(value, 5)).join(', ')));
  });
  const focused = document.activeElement?.id;
  const head = [...(several ? ['File'] : []), 'Column', 'Quantity', 'Unit', 'First values'];
  into.replaceChildren(h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Columns' }, h('table', { id: 'tables-columns' },
    h('thead', {}, h('tr', {}, ...head.map((name) => h('th', { scope: 'col' }, name)))), h('tbody', {}, ...body))));
  if (focused?.startsWith('tables-')) document.getElementById(focused)?.focus();
}

/** The quantity of every column, and buttons to open or save the run. */
function drawEcho(answer, tables, into) {
  const { taken, notes, others, forms, problem, kind, rows, files, map_file: map } = answer;
  if (problem) {
    into.replaceChildren(h('p', { id: 'tables-problem', class: 'error' }, h('strong', {}, 'No run can be made yet: '), problem));
    return;
  }
  const cells = taken.map(({ is, column, unit, range: [least, most], rows: count, file }) => h('tr', {}, h('th', { scope: 'row' }, is), h('td', {}, column), h('td', {}, unit), h('td', {}, `${number(least, 5)} to ${number(most, 5)}`), h('td', {}, `${count} of ${file}`)));
  const remarks = [...notes, ...others.map((other) => `not used: ${other}`), ...forms];
  const name = Object.keys(files).find((file) => file !== SESSION).replace(/(\.force)?\.csv$/, '');
  const encoder = new TextEncoder();
  const open = () => openSession({ name, files: Object.entries(files).map(([file, text]) => [`${name}/${file}`, encoder.encode(text)]) }, false, 'session').catch((error) => fail(error));
  into.replaceChildren(
    h('h3', {}, `Is this right? ${kind === 'insertion' ? 'An insertion' : 'A lateral run'} of ${rows} rows`),
    h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': 'Quantities and columns' }, h('table', { id: 'tables-taken' },
      h('thead', {}, h('tr', {}, ...['Quantity', 'Column', 'Unit', 'From ... to', 'Rows'].map((text) => h('th', { scope: 'col' }, text)))), h('tbody', {}, ...cells))),
    h('ul', { class: 'findings' }, ...remarks.map((text) => h('li', {}, text))),
    h('p', { class: 'bar' },
      h('button', { type: 'button', class: 'primary', id: 'tables-open', onclick: open }, 'Yes, open the session'),
      h('button', { type: 'button', onclick: () => Object.entries(files).forEach(([file, text]) => saveFile(file, text, 'text/plain')) }, 'Save the session\u2019s files'),
      h('button', { type: 'button', onclick: () => saveFile('map.toml', map, 'application/toml') }, 'Save the map')),
    h('p', { class: 'note' }, 'On the command line: ', h('code', { id: 'tables-command' }, tableCommand(tables, answer))));
}
