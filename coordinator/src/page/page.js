// Live updates, arrow-key navigation in matrices, and synchronous playback of
// all videos. Pages are readable without JavaScript.
"use strict";

const DISCONNECTED = "Disconnected from the coordinator; reconnecting automatically.";
const LIVE = "Live";
const CROWDED = "Too many pages are open: this one polls for changes.";
const CROWDED_MS = 15000;
const RETRY_MS = 2000;

// Merges a fetched copy into the page. Equal nodes stay, and inserting or removing a
// section moves no other section, so that focus, scroll positions, opened details
// and running videos are kept.
function merge(current, fetched) {
  const olds = [...current.childNodes];
  const news = [...fetched.childNodes];
  const partner = partners(olds, news);
  const paired = new Set(partner);
  let next = 0;
  news.forEach((fresh, index) => {
    const following = olds[next];
    const isRenamed = following && !paired.has(following) && following.nodeName === fresh.nodeName;
    const old = partner[index] || (isRenamed ? following : null);
    if (!old) {
      current.insertBefore(document.importNode(fresh, true), following || null);
      return;
    }
    while (olds[next] !== old) olds[next++].remove();
    next += 1;
    if (fresh.nodeType !== Node.ELEMENT_NODE) {
      if (old.data !== fresh.data) old.data = fresh.data;
    } else if (!old.isEqualNode(fresh)) {
      mergeElement(old, fresh);
    }
  });
  olds.slice(next).forEach((old) => old.remove());
}

// Merges a fetched copy of the page's content, and scrolls so that the anchor stays at
// its position on the screen. Browsers that do this themselves do it a frame later.
function show(fetched) {
  const main = document.getElementById("main");
  const anchor = scrollAnchor(main);
  const before = anchor && anchor.getBoundingClientRect().top;
  merge(main, fetched);
  if (anchor && anchor.isConnected) {
    window.scrollBy(0, anchor.getBoundingClientRect().top - before);
  }
}

// Returns the focused element if it is on the screen, otherwise the first block that
// begins there, or undefined at the top of the page, where new content is to be seen.
function scrollAnchor(main) {
  if (window.scrollY === 0) return undefined;
  const isInView = (element) => {
    const [box] = element.getClientRects();
    return box && box.top >= 0 && box.top < window.innerHeight;
  };
  const focused = document.activeElement;
  if (main !== focused && main.contains(focused) && isInView(focused)) return focused;
  const blocks = main.querySelectorAll("h2, h3, p, figure, pre, summary, tr, li");
  return [...blocks].find(isInView);
}

// Key that identifies a node among its siblings.
function keyOf(node) {
  if (node.nodeType !== Node.ELEMENT_NODE) return node.nodeName;
  const heading = node.querySelector(":scope > h2, :scope > h3, :scope > figcaption");
  const label = node.id || node.getAttribute("aria-label") || (heading ? heading.textContent : "");
  return `${node.nodeName} ${label}`;
}

// Returns for each new node the old node that matches it, or undefined. The matches
// are the longest common subsequence of the nodes' keys.
function partners(olds, news) {
  const [currentKeys, fetchedKeys] = [olds.map(keyOf), news.map(keyOf)];
  const partner = [];
  let start = 0;
  let [end, newEnd] = [currentKeys.length, fetchedKeys.length];
  for (; start < Math.min(end, newEnd) && currentKeys[start] === fetchedKeys[start]; start++) {
    partner[start] = olds[start];
  }
  while (end > start && newEnd > start && currentKeys[end - 1] === fetchedKeys[newEnd - 1]) {
    partner[--newEnd] = olds[--end];
  }
  if (start === end || start === newEnd) return partner;
  const [rows, columns] = [end - start, newEnd - start];
  const isSame = (i, j) => currentKeys[start + i] === fetchedKeys[start + j];
  const lengths = Array.from({ length: rows + 1 }, () => new Uint16Array(columns + 1));
  for (let i = rows - 1; i >= 0; i--) {
    for (let j = columns - 1; j >= 0; j--) {
      lengths[i][j] = isSame(i, j) ? lengths[i + 1][j + 1] + 1
        : Math.max(lengths[i + 1][j], lengths[i][j + 1]);
    }
  }
  for (let i = 0, j = 0; i < rows && j < columns;) {
    if (isSame(i, j)) partner[start + j++] = olds[start + i++];
    else if (lengths[i + 1][j] >= lengths[i][j + 1]) i += 1;
    else j += 1;
  }
  return partner;
}

function mergeElement(old, fresh) {
  // Attributes set by the reader or by this script, which the merge keeps.
  const owned = { DETAILS: ["open"], A: ["tabindex"], DIV: ["hidden"] }[old.tagName.toUpperCase()] || [];
  if (old.hasAttribute("data-keep") && old.getAttribute("src") === fresh.getAttribute("src")) return;
  if (old.matches("input, select, #player")) return;
  for (const { name } of [...old.attributes]) {
    if (!fresh.hasAttribute(name) && !owned.includes(name)) old.removeAttribute(name);
  }
  for (const { name, value } of [...fresh.attributes]) {
    if (old.getAttribute(name) !== value && !owned.includes(name)) old.setAttribute(name, value);
  }
  merge(old, fresh);
}

// Refresh: one request at a time, conditional on the entity tag. Each request is
// followed by a pause in proportion to its duration, to spare slow networks.
const PAUSE_PER_REQUEST = 5;
let tag = "";
let isRefreshing = false;
let isRefreshPending = false;

async function refresh() {
  if (isRefreshing) {
    isRefreshPending = true;
    return;
  }
  isRefreshing = true;
  const start = performance.now();
  try {
    const headers = tag ? { "If-None-Match": tag } : {};
    const answer = await fetch(location.href, { headers, cache: "no-store" });
    if (answer.redirected) location.reload();
    if (answer.status === 200 || answer.status === 404) {
      tag = answer.headers.get("ETag") || "";
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      document.title = page.title;
      show(page.getElementById("main"));
      showOrigin();
      centre();
      updateTabStops();
      watchVideos();
    }
  } catch {
    showConnection(DISCONNECTED, true);
  }
  setTimeout(() => {
    isRefreshing = false;
    if (isRefreshPending) {
      isRefreshPending = false;
      refresh();
    }
  }, PAUSE_PER_REQUEST * (performance.now() - start));
}

// Writes the coordinator's address, as the browser uses it, into the commands on the page.
function showOrigin() {
  for (const name of document.querySelectorAll("[data-origin]")) name.textContent = location.origin;
}

// Scrolls each picture that is wider than the screen to its middle, where the nominal
// rollout is, but only once, so that the reader can scroll it afterwards.
const centred = new WeakSet();

function centre() {
  for (const box of document.querySelectorAll(".centred")) {
    if (centred.has(box)) continue;
    centred.add(box);
    box.scrollLeft = (box.scrollWidth - box.clientWidth) / 2;
  }
}

function showConnection(text, isDisconnected) {
  const line = document.getElementById("connection");
  line.classList.toggle("cut", isDisconnected);
  if (line.textContent !== text) line.textContent = text;
}

// Change events from the coordinator. Hidden pages close their stream, because
// browsers limit the connections to one server.
let stream = null;
let retryTimer = 0;

function openStream() {
  clearTimeout(retryTimer);
  if (stream || document.hidden) return;
  stream = new EventSource("/events");
  stream.addEventListener("change", () => {
    showConnection(LIVE, false);
    refresh();
  });
  stream.addEventListener("error", async () => {
    if (stream && stream.readyState === EventSource.CONNECTING) {
      showConnection(DISCONNECTED, true);
      return;
    }
    closeStream();
    const crowded = await isReachable();
    showConnection(crowded ? CROWDED : DISCONNECTED, !crowded);
    if (crowded) refresh();
    retryTimer = setTimeout(openStream, crowded ? CROWDED_MS : RETRY_MS);
  });
}

function closeStream() {
  if (stream) stream.close();
  stream = null;
}

async function isReachable() {
  try {
    return (await fetch("/icon.svg", { cache: "no-store" })).ok;
  } catch {
    return false;
  }
}

document.addEventListener("visibilitychange", () => {
  if (document.hidden) {
    closeStream();
  } else {
    openStream();
  }
});

// Matrices: each has one tab stop, and arrow keys move the focus inside (roving tabindex).
function updateTabStops() {
  for (const panel of document.querySelectorAll("svg.panel[role=group]")) {
    const squares = [...panel.querySelectorAll("a")];
    const current = squares.find((square) => square === document.activeElement) ||
      squares.find((square) => square.getAttribute("tabindex") === "0") || squares[0];
    squares.forEach((square) => square.setAttribute("tabindex", square === current ? "0" : "-1"));
  }
}

// Returns the square that is nearest to another one in the direction of an arrow key, or null. A
// deviation from this direction counts fourfold, so that the focus stays in its row or column.
function nearest(squares, from, [dx, dy]) {
  const at = (square) => square.getBoundingClientRect();
  const { x, y } = at(from);
  let best = null;
  let least = Infinity;
  for (const square of squares) {
    const along = (at(square).x - x) * dx + (at(square).y - y) * dy;
    const across = Math.abs((at(square).x - x) * dy) + Math.abs((at(square).y - y) * dx);
    const distance = along + 4 * across;
    if (along > 1 && distance < least) [best, least] = [square, distance];
  }
  return best;
}

document.addEventListener("keydown", (event) => {
  const directions = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  const direction = directions[event.key];
  const panel = event.target.closest && event.target.closest("svg.panel[role=group]");
  if (!direction || !panel || event.target.tagName.toLowerCase() !== "a") return;
  event.preventDefault();
  const next = nearest(panel.querySelectorAll("a"), event.target, direction);
  if (next) {
    event.target.setAttribute("tabindex", "-1");
    next.setAttribute("tabindex", "0");
    next.focus();
  }
});

// Videos: shared controls. The longest video sets the length; shorter ones hold
// their last frame.
const player = () => document.getElementById("player");
const videos = () => [...document.querySelectorAll("video")];
const longest = () => videos().reduce((a, b) => ((b.duration || 0) > (a.duration || 0) ? b : a));

function watchVideos() {
  if (!player()) return;
  // Videos are uploaded after their outcomes, so a refresh may add some.
  const speed = document.getElementById("speed");
  for (const video of videos()) {
    video.removeAttribute("controls");
    video.playbackRate = Number(speed.value);
  }
  if (!player().hidden) return;
  player().hidden = false;
  document.getElementById("play").addEventListener("click", playOrPause);
  document.getElementById("scrub").addEventListener("input", scrub);
  speed.addEventListener("change", watchVideos);
  requestAnimationFrame(showTime);
}

function isPlaying() {
  return videos().some((video) => !video.paused && !video.ended);
}

function playOrPause() {
  if (isPlaying()) {
    videos().forEach((video) => video.pause());
    return;
  }
  const lead = longest();
  const time = lead.ended ? 0 : lead.currentTime;
  for (const video of videos()) {
    video.currentTime = Math.min(time, video.duration || 0);
    if (time < (video.duration || 0)) video.play();
  }
}

function scrub(event) {
  const time = (event.target.value / 1000) * (longest().duration || 0);
  videos().forEach((video) => {
    video.pause();
    video.currentTime = Math.min(time, video.duration || 0);
  });
}

function showTime() {
  if (!player()) return;
  const lead = longest();
  const play = isPlaying() ? "Pause" : "Play";
  const button = document.getElementById("play");
  if (button.textContent !== play) button.textContent = play;
  document.getElementById("time").textContent = `${lead.currentTime.toFixed(1)} s`;
  const slider = document.getElementById("scrub");
  if (!slider.matches(":active")) {
    slider.value = String((1000 * lead.currentTime) / (lead.duration || 1));
  }
  requestAnimationFrame(showTime);
}

showConnection(LIVE, false);
showOrigin();
centre();
updateTabStops();
watchVideos();
openStream();
