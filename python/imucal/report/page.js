"use strict";
// Draws the figures in the colours of the theme, and makes tabs of the sections. Nothing here changes a number.
(() => {
  const root = document.documentElement;
  const dark = JSON.parse(document.getElementById("dark").textContent);
  const prefersDark = matchMedia("(prefers-color-scheme: dark)");
  const touch = matchMedia("(pointer: coarse)").matches;
  const figures = [...document.querySelectorAll("figure")].map((figure) => ({
    place: figure.querySelector(".plot"),
    text: figure.querySelector("script").textContent,
  }));
  const tabs = [...document.querySelectorAll(".tab")];
  const bar = document.getElementById("tabs");
  const toggle = document.getElementById("theme");
  // Width of a figure on paper, CSS pixels: the width of one of the two columns of a printed page.
  const PAPER_WIDTH = 330;
  // Height of a figure on paper, divided by its height on the screen.
  const PAPER_HEIGHT = 0.78;
  let chosen = null;

  // A figure is drawn when its tab is opened for the first time, because drawing all figures takes seconds on a phone.
  function draw(figure, theme, width) {
    // When the page opens, a compressed plotly.js is not yet available.
    if (!window.Plotly) return undefined;
    const look = `${theme} ${width ?? ""}`;
    if (figure.look === look) return Plotly.Plots.resize(figure.place);
    figure.look = look;
    const { data, layout } = JSON.parse(figure.text, (_, value) =>
      theme === "dark" && typeof value === "string" && value in dark ? dark[value] : value);
    if (width) {
      layout.width = width;
      layout.height = Math.max(150, PAPER_HEIGHT * layout.height);
      layout.font.size = 9;
      if (layout.legend) layout.legend.font = { size: 8 };
      (layout.annotations ?? []).forEach((note) => { note.font = { ...note.font, size: 9 }; });
      Object.keys(layout).filter((key) => /^[xy]axis/.test(key)).forEach((key) => {
        layout[key].tickfont = { ...layout[key].tickfont, size: 8 };
        if (layout[key].title) layout[key].title.font = { size: 9 };
      });
    }
    // If the user has rotated a sphere, the view is kept.
    if (layout.scene && figure.place.layout) layout.scene.camera = figure.place.layout.scene.camera;
    // On a touch screen, a finger that moves over a two-dimensional plot scrolls the page instead of zooming the plot.
    if (touch) layout.dragmode = false;
    return Plotly.react(figure.place, data, layout, {
      responsive: true,
      displayModeBar: false,
      scrollZoom: false,
    });
  }

  function paint() {
    const theme = chosen ?? (prefersDark.matches ? "dark" : "light");
    root.dataset.theme = theme;
    toggle.textContent = theme === "dark" ? "Light" : "Dark";
    toggle.setAttribute("aria-label", `${toggle.textContent} colours`);
    figures.filter((figure) => !figure.place.closest("[hidden]")).forEach((figure) => draw(figure, theme));
  }

  function show(tab, focus) {
    tabs.forEach((other) => { other.hidden = other !== tab; });
    [...bar.children].forEach((button) => {
      const selected = button.getAttribute("aria-controls") === tab.id;
      button.setAttribute("aria-selected", selected);
      button.tabIndex = selected ? 0 : -1;
      if (selected && focus) button.focus();
      if (selected) bar.scrollLeft = button.offsetLeft - bar.clientWidth / 3;
    });
    paint();
  }

  function makeTabs() {
    tabs.forEach((tab) => {
      const button = document.createElement("button");
      button.type = "button";
      button.id = `show-${tab.id}`;
      button.textContent = tab.querySelector("h2").textContent;
      button.setAttribute("role", "tab");
      button.setAttribute("aria-controls", tab.id);
      button.addEventListener("click", () => {
        show(tab);
        history.replaceState(null, "", `#${tab.id}`);
      });
      tab.setAttribute("role", "tabpanel");
      tab.setAttribute("aria-labelledby", button.id);
      bar.append(button);
    });
    bar.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step === undefined) return;
      const at = tabs.findIndex((tab) => !tab.hidden);
      show(tabs[(at + step + tabs.length) % tabs.length], true);
    });
    bar.hidden = false;
    document.body.classList.add("tabbed");
    const open = () => {
      const target = location.hash ? document.getElementById(decodeURIComponent(location.hash.slice(1))) : null;
      show(tabs.find((tab) => tab.contains(target)) ?? tabs[0]);
      if (!target || tabs.includes(target)) return;
      if (target instanceof HTMLDetailsElement) target.open = true;
      target.scrollIntoView();
    };
    addEventListener("hashchange", open);
    open();
  }

  // Buttons that save a text of the page as a file.
  document.querySelectorAll("button[data-file]").forEach((button) => {
    button.hidden = false;
    button.addEventListener("click", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([document.getElementById(button.dataset.from).textContent]));
      link.download = button.dataset.file;
      link.click();
      URL.revokeObjectURL(link.href);
    });
  });

  toggle.hidden = false;
  toggle.addEventListener("click", () => {
    const other = root.dataset.theme === "dark" ? "light" : "dark";
    // If the user chooses the theme that the system has, the page follows later changes of the system's theme.
    chosen = other === (prefersDark.matches ? "dark" : "light") ? null : other;
    paint();
  });
  prefersDark.addEventListener("change", paint);
  addEventListener("plotlyready", paint);
  if (tabs.length > 1) makeTabs();
  else paint();

  // On paper, the theme is light, all tabs are shown, and figures are as wide as a column of the printed page.
  let before = null;
  addEventListener("beforeprint", () => {
    before = tabs.map((tab) => tab.hidden);
    tabs.forEach((tab) => { tab.hidden = false; });
    root.dataset.theme = "light";
    figures.filter((figure) => !figure.place.closest(".screen"))
      .forEach((figure) => draw(figure, "light", PAPER_WIDTH));
  });
  addEventListener("afterprint", () => {
    tabs.forEach((tab, i) => { tab.hidden = before[i]; });
    paint();
  });
})();
