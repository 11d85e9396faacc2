"use strict";
// The one script of a report. No library, no eval, nothing from elsewhere; the page is readable without it.
(() => {
  // --- tables sorted by their heads ------------------------------------------------------------------------------
  const numeric = /^[−+-]?[\d.,]+(e[−+-]?\d+)?/i;

  const cellKey = (row, k) => {
    const cell = row.cells[k];
    if (!cell) return null;
    const text = (cell.dataset.v ?? cell.textContent).trim();
    if (text === "" || text === "–") return null;
    return numeric.test(text) ? parseFloat(text.replace(/−/g, "-").replace(/,/g, "")) : text.toLowerCase();
  };

  const before = (a, b) => {
    if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
    return typeof a === "number" ? -1 : 1;
  };

  const sortTable = (table, k, direction) => {
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row, n) => ({ row, n: row.dataset.n ?? (row.dataset.n = n), key: cellKey(row, k) }));
    rows.sort((a, b) => {
      if (direction === 0) return a.n - b.n;
      if (a.key === null || b.key === null) return (a.key === null) - (b.key === null) || a.n - b.n;
      return direction * before(a.key, b.key) || a.n - b.n;
    });
    body.append(...rows.map((r) => r.row));
  };

  const makeSortable = (table) => {
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
    heads.forEach((head, k) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const now = head.getAttribute("aria-sort");
        const next = now === null ? "ascending" : now === "ascending" ? "descending" : null;
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        if (next) head.setAttribute("aria-sort", next);
        sortTable(table, k, next === "ascending" ? 1 : next === "descending" ? -1 : 0);
      });
    });
  };

  document.documentElement.classList.add("scripted");
  document.querySelectorAll("table.sortable").forEach(makeSortable);
})();
