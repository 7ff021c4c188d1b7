// Predict: drag the depth up to which readings are used; path and band follow.

function showPredict() {
  within('predict', async (isHere) => {
    const session = await result('session', {}, 'Reading the runs');
    if (!isHere()) return;
    if (session.insertion.length === 0) {
      main().append(section('Path of the tip', h('p', {}, 'This session has no insertions: there is no path to predict.')));
      return;
    }
    const deepest = Math.max(...session.insertion.map((run) => Math.max(...run.depth_mm)));
    const most = Math.max(10, Math.floor(deepest - 5));
    let until = Math.min(most, Math.max(5, Number(state.choice.until ?? Math.min(50, Math.floor(0.5 * deepest)))));
    const [vertical, horizontal, ahead, facts, made] = ['drawn', 'drawn', 'drawn', '', ''].map((name) => h('div', { class: name }));
    const pick = h('select', { id: 'predict-run', onchange: () => { keepAddress({ insertion: pick.value }); draw(); } },
      ...session.insertion.map((run) => h('option', { value: run.id }, run.id)));
    pick.value = state.choice.insertion ?? pick.value;
    if (pick.selectedIndex < 0) pick.selectedIndex = 0;
    const diagnosed = await foundModel();
    if (!isHere()) return;
    // The model contains the effects that a diagnosis has found, unless the reader chooses the plain model.
    const usable = diagnosed && diagnosed.names.length > 0 ? diagnosed : null;
    let isPlain = !usable || state.choice.model === 'plain';
    const model = h('div', { id: 'predict-model' });
    const showModel = () => model.replaceChildren(usable
      ? modelLine(isPlain ? 'plain, without the effects that Diagnose has found ' : `with the effects that Diagnose has found: ${usable.names.join(', and ')} `,
        h('button', { type: 'button', class: 'small', onclick: () => { isPlain = !isPlain; keepAddress({ model: isPlain ? 'plain' : '' }); showModel(); ask(); } }, isPlain ? 'Use these effects' : 'Use the plain model'))
      : modelLine(diagnosed ? 'plain; Diagnose names no effect of this session ' : 'plain; this session has not been diagnosed ',
        diagnosed ? '' : h('button', { type: 'button', class: 'small', onclick: () => show('diagnose') }, 'Diagnose')));
    let answer = null;
    const ask = latest(async () => {
      try {
        const value = await engine.request('quick', { do: 'predict', dir: state.session, until_mm: until, ...(isPlain ? {} : { model: usable.model }) });
        if (!isHere()) return;
        answer = value;
        hideFault();
        announce(null);
        draw();
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const draw = () => { if (answer) drawPrediction(answer, pick.value, { vertical, horizontal, ahead, facts, made }); };
    main().append(
      section('Path of the tip', h('p', {}, h('label', { for: 'predict-run' }, 'Insertion '), pick),
        slider('predict-until', 'Readings are used up to', 'mm', [5, most, 1], until, (value) => { until = value; keepAddress({ until }); ask(); }),
        model, facts, h('div', { class: 'panels' },
          h('div', { class: 'panel' }, h('h3', {}, 'Vertical'), vertical), h('div', { class: 'panel' }, h('h3', {}, 'Horizontal'), horizontal),
          h('div', { class: 'panel' }, h('h3', {}, 'View along the needle'), ahead))),
      section('Figure', made), saveBar('predict', () => answer.document));
    showModel();
    responsive(vertical, draw);
    announce('Predicting ...');
    ask();
  });
}

function drawPrediction({ document: found, figures }, id, { vertical, horizontal, ahead, facts, made }) {
  const one = found.insertions.find((insertion) => insertion.id === id);
  if (!one || one.error) {
    facts.replaceChildren(h('p', {}, one ? `skipped: ${one.error}` : 'no such insertion'));
    [vertical, horizontal, ahead, made].forEach((box) => box.replaceChildren());
    return;
  }
  const until = one.identified_until_mm;
  const plane = (into, name, tip, low, high, measured) => {
    if (!tip) { into.replaceChildren(h('p', { class: 'note' }, 'not measured')); return; }
    const used = measured.map((value, i) => (one.depth_mm[i] <= until ? value : null));
    const rest = measured.map((value, i) => (one.depth_mm[i] > until ? value : null));
    plot(into, { title: `${name} path of the tip, predicted beyond ${number(until)} mm`, x: 'insertion depth, mm', y: 'tip, mm', height: 260,
      marks: [{ x: until, label: 'predicted from here' }],
      series: [{ kind: 'band', x: one.depth_mm, low, high, style: 'a' }, { kind: 'line', x: one.depth_mm, y: tip, style: 'a', label: 'predicted, with 95 % band' },
        { kind: 'dots', x: one.depth_mm, y: used, style: 'c', label: 'used' }, { kind: 'dots', x: one.depth_mm, y: rest, style: 'b', label: 'measured, not used' }] });
  };
  plane(vertical, 'Vertical', one.tip_y_mm, one.lo95_y_mm, one.hi95_y_mm, one.measured_y_mm);
  plane(horizontal, 'Horizontal', one.tip_x_mm, one.lo95_x_mm, one.hi95_x_mm, one.measured_x_mm);
  if (one.tip_x_mm) {
    plot(ahead, { title: 'Tip, viewed along the needle', x: 'horizontal, mm', y: 'vertical, mm', height: 260, square: true,
      series: [{ kind: 'line', x: one.tip_x_mm, y: one.tip_y_mm, style: 'a', label: 'predicted' }, { kind: 'dots', x: one.measured_x_mm, y: one.measured_y_mm, style: 'b', label: 'measured' }] });
  } else {
    ahead.replaceChildren(h('p', { class: 'note' }, 'only one plane was measured'));
  }
  const load = Number.isFinite(one.tip_force_n) ? `tip load ${number(one.tip_force_n)} N (${interval(one.tip_force_ci95_n)})` : '';
  const k = one.learned?.k_kpa;
  const error = Number.isFinite(one.last_error_mm) ? `prediction and measurement differ by ${number(one.last_error_mm, 2)} mm at ${number(one.last_measured_mm)} mm; ${one.band_held} of ${one.band_readings} readings lie in the band` : '';
  facts.replaceChildren(h('p', { class: 'readout', id: 'predict-facts', 'data-until': until }, [load, Number.isFinite(k) ? `K ${number(k)} kPa` : '', error].filter(Boolean).join('; ')));
  const drawn = figures.find((figureOf) => figureOf.name === `${id}.path`);
  made.replaceChildren(...(drawn ? [figure(drawn)] : []));
}
