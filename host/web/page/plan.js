// Plan: the interval that a lateral run will give, as a map over insertion depth and displacement, before the run is made.

const PLAN_SLIDERS = [
  ['least_kpa', 'Smallest modulus of the tissue', 'kPa', 0.5, 100, 0.5, 5],
  ['most_kpa', 'Largest modulus of the tissue', 'kPa', 0.5, 100, 0.5, 30],
  ['hold_s', 'Duration of a hold', 's', 2, 20, 0.5, 3],
  ['force_limit_n', 'Largest force', 'N', 0.5, 10, 0.5, 4],
  ['strain_limit_percent', 'Largest strain of the needle', '%', 0.02, 0.5, 0.02, 0.2],
  ['deflection_limit_mm', 'Largest deflection in the tissue', 'mm', 0.1, 5, 0.1, 2.5],
];
const PLAN_DEPTHS = [10, 20, 30, 40, 50, 60, 70, 80, 90, 100];
const PLAN_DISPLACEMENTS = [0.2, 0.4, 0.8, 1.2, 1.6, 2, 2.5, 3];
/** Upper ends of the colour steps, as half-widths in percent; wider intervals are pale. */
const PLAN_STEPS = [[1, 8], [2, 7], [4, 6], [8, 4], [16, 3], [32, 2], [64, 1]];

const percent = (value) => (Number.isFinite(value) ? `${number(value, value < 10 ? 2 : 3)} %` : 'not identifiable');
const stepOf = (value) => (PLAN_STEPS.find(([most]) => value <= most) ?? [0, 0])[1];

function showPlan() {
  within('plan', async (isHere) => {
    const values = Object.fromEntries(PLAN_SLIDERS.map(([name, , , , , , start]) => [name, Number(state.choice[name] ?? start)]));
    const chosen = { depth: Number(state.choice.depth ?? 40), displacement: Number(state.choice.displacement ?? 1.2) };
    const [map, facts, made] = ['drawn', '', ''].map((name) => h('div', { class: name }));
    let answer = null;
    const draw = () => { if (answer) drawPlan(answer, chosen, { map, facts, made }, choose); };
    const ask = latest(async () => {
      try {
        const { least_kpa: least, most_kpa: most, ...limits } = values;
        const value = await engine.request('quick', { do: 'plan', dir: state.session, modulus_kpa: [Math.min(least, most), Math.max(least, most)],
          depth_mm: PLAN_DEPTHS, displacement_mm: PLAN_DISPLACEMENTS, ...limits });
        if (!isHere()) return;
        answer = value;
        hideFault();
        announce(null);
        draw();
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const choose = (more) => {
      Object.assign(chosen, more);
      selects.forEach(([name, select]) => { select.value = chosen[name]; });
      keepAddress(chosen);
      draw();
    };
    const of = (name, label, all) => {
      const select = h('select', { id: `plan-${name}`, onchange: () => choose({ [name]: Number(select.value) }) },
        ...all.map((mm) => h('option', { value: mm, selected: mm === chosen[name] }, `${mm} mm`)));
      if (select.selectedIndex < 0) select.selectedIndex = 0;
      chosen[name] = Number(select.value);
      return [name, select, h('div', { class: 'slider' }, h('label', { for: `plan-${name}` }, label), select)];
    };
    const selects = [of('depth', 'Insertion depth', PLAN_DEPTHS), of('displacement', 'Displacement of guide 2', PLAN_DISPLACEMENTS)];
    const sliders = PLAN_SLIDERS.map(([name, label, unit, least, most, step]) =>
      slider(`plan-${name}`, label, unit, [least, most, step], values[name], (value) => { values[name] = value; keepAddress(values); ask(); }));
    main().append(
      h('div', { class: 'two' },
        h('section', { class: 'controls' }, h('h2', {}, 'Tissue, run and limits'),
          h('p', { class: 'note' }, state.session ? `Needle, guides and noise of ${state.session}.` : 'An 18 gauge steel needle in the standard rig. Open a session to use its needle and rig.'),
          ...sliders),
        h('section', {}, h('h2', {}, 'Accuracy of a run: half-width of the 95 % interval, without model error'),
          modelLine('plain: tissue of one stiffness, no effect'),
          h('p', { class: 'note' }, 'Rows: displacement of guide 2, mm. Numbers: the largest half-width over the range of the modulus, percent. A strong colour marks an accurate run, a dashed red border a run that exceeds a limit.'), map,
          h('h2', {}, 'One run'), ...selects.map(([, , row]) => row), facts)),
      section('Figure', made), saveBar('plan', () => answer.document));
    responsive(map, draw);
    announce('Planning ...');
    ask();
  });
}

function drawPlan({ document: found, figures }, chosen, { map, facts, made }, choose) {
  const modulus = found.protocol.foundation === 'body' ? 'E' : 'K';
  const rows = [...PLAN_DISPLACEMENTS].reverse();
  // Millimetres come back from metres.
  const near = (all, value) => all.findIndex((one) => Math.abs(one - value) < 1e-6);
  const cells = found.choices.map((one) => {
    const [column, row] = [near(PLAN_DEPTHS, one.depth_mm), near(rows, one.displacement_mm)];
    const width = one.half_width_percent ?? Infinity;
    const step = stepOf(width);
    return {
      column, row, strong: step > 4, style: `below s${step}${one.within_limits ? '' : ' broken'}`,
      text: Number.isFinite(width) ? number(width, 2) : '-',
      name: `${number(one.depth_mm)} mm deep, ${number(one.displacement_mm)} mm displaced: ${modulus} \u00b1 ${percent(width)}${one.within_limits ? '' : ', exceeds a limit'}`,
      isChosen: column === near(PLAN_DEPTHS, chosen.depth) && row === near(rows, chosen.displacement),
      onclick: () => choose({ depth: PLAN_DEPTHS[column], displacement: rows[row] }),
    };
  });
  cellMap(map, { title: `Half-width of the interval of ${modulus} in percent, over insertion depth and displacement`, columns: PLAN_DEPTHS.map(String), rows: rows.map((mm) => number(mm)), cells, columnName: 'insertion depth, mm' });
  const one = found.choices.find((choice) => near([choice.depth_mm], chosen.depth) === 0 && near([choice.displacement_mm], chosen.displacement) === 0);
  const best = found.best;
  facts.replaceChildren(
    one ? h('p', { class: 'readout', id: 'plan-facts', 'aria-live': 'polite', 'data-percent': one.half_width_percent }, h('span', { class: 'big' }, `${modulus} \u00b1 ${percent(one.half_width_percent ?? Infinity)}`),
      ` force up to ${number(one.force_n)} N, strain of the needle ${number(one.needle_strain_percent, 2)} %, ${number(one.deflection_mm)} mm in the tissue${one.within_limits ? '' : ': exceeds a limit'}`) : '',
    best ? h('p', {}, `Narrowest within the limits: ${number(best.depth_mm)} mm deep, ${number(best.displacement_mm)} mm displaced, ${modulus} \u00b1 ${percent(best.half_width_percent)} `,
      h('button', { type: 'button', class: 'small', id: 'plan-best', onclick: () => choose({ depth: Number(best.depth_mm.toFixed(6)), displacement: Number(best.displacement_mm.toFixed(6)) }) }, 'Choose it'))
      : h('p', {}, `No run of the map is within the limits and identifies ${modulus}.`));
  made.replaceChildren(...figures.map(figure));
}
