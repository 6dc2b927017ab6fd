// Order of search results: pages whose title holds the words come first; lists that name everything come last, unless
// their own title holds all words. Answers of "How do I ...?" are found by their titles and their words of the index.
const asked = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase().split(/\s+/).filter(Boolean);
const lists = ["how_do_i", "reference", "about", "design", "measurements", "fields", "api", "gallery/index", "index", "guide"];
const share = (name) => asked.filter((word) => name.toLowerCase().includes(word.slice(0, 6))).length / Math.max(1, asked.length);
var Scorer = {
  score: ([page, title, anchor, description, score]) => {
    const guide = page.includes("generated/") ? -30 : page.startsWith("gallery/") ? 0 : 10;
    const isAnswer = page === "how_do_i" && anchor;
    const list = lists.includes(page) && !isAnswer && share(title.split(" > ")[0]) < 1;
    return score + 40 * share(title) + guide - (list ? 130 : 0);
  },
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
