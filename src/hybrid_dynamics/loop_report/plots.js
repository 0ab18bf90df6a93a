// Draws each figure when it comes near the window, in the colours of the page (light, dark, print).
(function () {
  "use strict";
  const { templates, figures } = JSON.parse(document.getElementById("plots").textContent);
  const drawn = new Set();

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(name).trim();
    return { ink: of("--ink"), muted: of("--muted"), line: of("--line"), paper: of("--paper"), after: of("--after"),
      dark: matchMedia("(prefers-color-scheme: dark)").matches && !matchMedia("print").matches };
  }

  function paint(model, c) {
    switch (model.type) {
      case "LinearAxis":
        model.axis_label_text_color = c.ink;
        model.major_label_text_color = c.ink;
        model.axis_line_color = c.muted;
        model.major_tick_line_color = c.muted;
        model.minor_tick_line_color = null;
        break;
      case "Grid":
        model.grid_line_color = c.line;
        break;
      case "Title":
        model.text_color = c.ink;
        break;
      case "Legend":
        model.label_text_color = c.ink;
        model.background_fill_color = c.paper;
        model.background_fill_alpha = 0.8;
        break;
    }
    if (model.tags && model.tags.includes("after")) model.line_color = c.after;
    // A run's points: its colour on the light page, then on the dark one.
    if (model.tags && model.tags[0] === "run") model.fill_color = model.tags[c.dark ? 2 : 1];
    // Measured torque and what is missing are drawn in the page's ink.
    if (model.tags && model.tags.includes("ink")) {
      for (const name of ["line_color", "fill_color"]) if (name in model.attributes) model[name] = c.ink;
    }
  }

  function repaint() {
    if (!window.Bokeh) return;
    const c = colours();
    for (const doc of Bokeh.documents) for (const model of doc._all_models.values()) paint(model, c);
  }

  // The template of a figure with its blanks filled: "@@name" alone in a list is a column, elsewhere a text.
  function filled({ kind, values }) {
    const blank = (item) => typeof item === "string" && item.startsWith("@@");
    return JSON.parse(JSON.stringify(templates[kind]), (key, item) => {
      if (blank(item)) return key === "0" && typeof values[item.slice(2)] === "object" ? item : values[item.slice(2)];
      if (Array.isArray(item) && item.length === 1 && blank(item[0])) return values[item[0].slice(2)];
      if (item && item.name === "Range1d" && Array.isArray(item.attributes.tags)) {
        const [start, end] = item.attributes.tags;
        item.attributes = { start, end };
      }
      return item;
    });
  }

  async function draw(place) {
    if (drawn.has(place.id)) return;
    drawn.add(place.id);
    const figure = figures[Number(place.id.slice(5)) - 1];
    await Bokeh.embed.embed_item({ ...filled(figure), target_id: place.id });
    repaint();
    place.dataset.drawn = "yes";
  }

  const places = [...document.querySelectorAll(".plot")];
  const near = new IntersectionObserver(
    (seen) => { for (const one of seen) if (one.isIntersecting) draw(one.target); }, { rootMargin: "300px" });
  for (const place of places) near.observe(place);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  window.addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details:has(.plot)")) folded.open = true;
    for (const place of places) draw(place);
  });
})();
