// Order of search results: pages whose title holds the words come first; lists that name everything come last.
const asked = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase().split(/\s+/).filter(Boolean);
const lists = ["how_do_i", "reference", "about", "design", "measurements", "fields", "api", "gallery/index"];
var Scorer = {
  score: ([page, title, anchor, description, score]) => {
    const name = title.toLowerCase();
    const found = asked.filter((word) => name.includes(word.slice(0, 6))).length / Math.max(1, asked.length);
    const guide = page.includes("generated/") ? -30 : page.startsWith("gallery/") ? 0 : 10;
    return score + 40 * found + guide - (lists.includes(page) ? 130 : 0);
  },
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
