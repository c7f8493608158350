// Filters, sorting and printing: what every page has. Without it the page is complete, and longer.
"use strict";
(() => {
  const FIRST_CLAIMS = 24;
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];

  // Sorting: by the number a cell begins with, else by its text; what has neither comes last.
  const key = (row, column) => {
    const cell = row.cells[column];
    const text = (cell.dataset.sort ?? cell.textContent).trim();
    const number = parseFloat(text.replace(/[\u2212]/g, "-").replace(/,(?=\d{3})/g, ""));
    return Number.isNaN(number) ? text.toLowerCase() : number;
  };
  const compare = (a, b, up) => {
    const rank = (value) => (value === "" || value === "-" || value === "–" ? 2 : typeof value === "string" ? 1 : 0);
    if (rank(a) !== rank(b)) return rank(a) - rank(b);
    return (a < b ? -1 : a > b ? 1 : 0) * (up ? 1 : -1);
  };
  const sort = (table, head) => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    all("thead th", table).forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const rows = [...table.tBodies[0].rows].map((row) => [key(row, head.cellIndex), row]);
    rows.sort(([a], [b]) => compare(a, b, up));
    table.tBodies[0].append(...rows.map(([, row]) => row));
  };
  const makeSortable = (table) => {
    for (const head of all("thead th", table)) {
      if (head.querySelector("button") || !head.textContent.trim()) continue;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => sort(table, head));
    }
  };
  all("table[data-sortable]").forEach(makeSortable);

  // Filters of the claims: pressed verdicts, whose claim it is, part of the paper, words.
  const claims = document.getElementById("claims-filters");
  if (claims) {
    const rows = all("#claims-table tbody tr");
    const said = document.getElementById("claims-shown");
    const more = document.getElementById("claims-more");
    let most = FIRST_CLAIMS;
    const pressed = (group) => all(`button[data-${group}][aria-pressed="true"]`, claims).map((b) => b.dataset[group]);
    const update = () => {
      const verdicts = pressed("verdict");
      const whose = pressed("own");
      const part = claims.querySelector("select").value;
      const words = claims.querySelector("input").value.toLowerCase().split(/\s+/).filter(Boolean);
      let found = 0;
      for (const row of rows) {
        const text = row.textContent.toLowerCase();
        const keep = (!verdicts.length || verdicts.includes(row.dataset.verdict)) &&
          (!whose.length || whose.includes(row.dataset.own)) &&
          (!part || part === row.dataset.part) && words.every((word) => text.includes(word));
        found += keep;
        row.hidden = !keep || found > most;
      }
      said.textContent = `${Math.min(found, most)} of ${rows.length} claims shown` + (found < rows.length ? `, ${found} fit` : "");
      more.hidden = found <= most;
      more.textContent = `Show all ${found}`;
    };
    more.addEventListener("click", () => {
      const next = rows.findIndex((row) => row.hidden);
      most = Infinity;
      update();
      rows[next]?.querySelector("summary").focus();
    });
    for (const button of all("button[aria-pressed]", claims)) {
      button.addEventListener("click", () => {
        button.setAttribute("aria-pressed", button.getAttribute("aria-pressed") !== "true");
        update();
      });
    }
    claims.querySelector("select").addEventListener("change", update);
    claims.querySelector("input").addEventListener("input", update);
    claims.querySelector("[data-reset]").addEventListener("click", () => {
      all("button[aria-pressed]", claims).forEach((button) => button.setAttribute("aria-pressed", "false"));
      claims.querySelector("select").value = "";
      claims.querySelector("input").value = "";
      update();
    });
    update();
    addEventListener("beforeprint", () => { most = Infinity; update(); });

    // A link to a row that a filter hides shows it.
    const reveal = () => {
      const row = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
      if (row && row.hidden) {
        most = Infinity;
        claims.querySelector("[data-reset]").click();
        row.scrollIntoView();
      }
    };
    addEventListener("hashchange", reveal);
    reveal();
  }

  // On paper nothing can be opened.
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = all("details:not([open])").filter((part) => !part.hasAttribute("data-long"));
    closed.forEach((part) => { part.open = true; });
  });
  addEventListener("afterprint", () => closed.forEach((part) => { part.open = false; }));

  window.ovibjaxPage = { makeSortable };
})();
