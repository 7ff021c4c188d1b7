// Blocks: K/E of a needle over the size of the gel that it is in, held in a box or free.

const BLOCKS_SLIDERS = [
  ['depth', 'Insertion depth', 'mm', 10, 100, 1, 30],
  ['poisson', 'Poisson\u2019s ratio of the tissue', '', 0.4, 0.5, 0.01, 0.5],
];

function showBlocks() {
  within('blocks', async (isHere) => {
    const values = Object.fromEntries(BLOCKS_SLIDERS.map(([name, , , , , , start]) => [name, Number(state.choice[name] ?? start)]));
    const [made, facts] = ['made', ''].map((name) => h('div', { class: name }));
    let answer = null;
    const ask = latest(async () => {
      try {
        const value = await engine.request('quick', { do: 'blocks', dir: state.session, depth_mm: values.depth, poisson: values.poisson });
        if (!isHere()) return;
        answer = value;
        hideFault();
        announce(null);
        made.replaceChildren(...answer.figures.map(figure));
        facts.replaceChildren(blocksFacts(answer.document));
      } catch (error) {
        if (isHere()) fail(error);
      }
    });
    const sliders = BLOCKS_SLIDERS.map(([name, label, unit, least, most, step]) =>
      slider(`blocks-${name}`, label, unit, [least, most, step], values[name], (value) => { values[name] = value; keepAddress(values); ask(); }));
    main().append(
      h('div', { class: 'two' },
        h('section', { class: 'controls' }, h('h2', {}, 'A needle in a gel'),
          h('p', { class: 'note' }, state.session ? `The needle of ${state.session}.` : 'An 18 gauge needle. Open a session to use its needle.'),
          ...sliders,
          h('p', { class: 'note' }, 'To get E, divide K by K/E. Held: the gel sticks to a rigid box; free: it stands without a box. A session states its block in [tissue]: body_mm, needle_at_mm, sides, far_side.')),
        h('section', {}, h('h2', {}, 'K/E for blocks of different sizes'), modelLine('a needle in an elastic block, no effect'), made, facts)),
      saveBar('blocks', () => answer.document));
    announce('Computing the effect of the walls ...');
    ask();
  });
}

/** K/E in a gel of a common size, and the error of E computed with a half space. */
function blocksFacts({ edge_mm: edges, held, free, half_space: far }) {
  const least = edges.findIndex((edge) => edge >= 60);
  const at = least < 0 ? edges.length - 1 : least;
  if (at < 0) return h('p', { class: 'readout', id: 'blocks-facts' }, 'No cube up to 300 mm has room for this needle.');
  const times = (ratio) => number(ratio / far, 3);
  return h('p', { class: 'readout', id: 'blocks-facts', 'aria-live': 'polite', 'data-held': held[at], 'data-free': free[at] },
    h('span', { class: 'big' }, `${edges[at]} mm: K/E ${number(held[at], 3)} held, ${number(free[at], 3)} free`),
    `; without walls ${number(far, 3)}. A model without the walls gives ${times(held[at])} times (held) or ${times(free[at])} times (free) the true E`);
}
