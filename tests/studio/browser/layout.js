// Texts that are cut, controls that are off the screen, beyond a part that does not scroll, or under another element.
() => {
  const faults = [];
  const name = (element) => {
    const own = element.closest("[id]");
    const text = (element.value || element.textContent || "").trim().replace(/\s+/g, " ").slice(0, 50);
    return `${own ? "#" + own.id + " " : ""}${element.tagName.toLowerCase()}${element.name ? `[${element.name}]` : ""} "${text}"`;
  };
  const texts = document.createElement("canvas").getContext("2d");
  const needed = (element) => {
    const style = getComputedStyle(element);
    texts.font = style.font;
    const text = element instanceof HTMLSelectElement ? (element.selectedOptions[0]?.textContent ?? "") : (element.value || element.placeholder);
    const sides = ["paddingLeft", "paddingRight", "borderLeftWidth", "borderRightWidth"].reduce((sum, side) => sum + parseFloat(style[side]), 0);
    return texts.measureText(text).width + sides + (element instanceof HTMLSelectElement ? 14 : 0);
  };
  const CONTROLS = "button, select, input, textarea, a[href], summary, [role=button], [tabindex='0']";
  const top = document.querySelector("dialog[open]") ?? document.body;
  for (const element of top.querySelectorAll("*")) {
    if (element.closest("[inert]") || !element.checkVisibility({ visibilityProperty: true, opacityProperty: true })) continue;
    const style = getComputedStyle(element);
    let rect = element.getBoundingClientRect();
    const control = element.matches(CONTROLS);
    const text = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (/auto|scroll/.test(style.overflowX) && style.overflowY !== "hidden" && element.scrollHeight > element.clientHeight && element.scrollWidth > element.clientWidth + 1)
      faults.push(`wider than its part: ${name(element)}, ${element.scrollWidth} of ${element.clientWidth} px`);
    if (!control && !text) continue;
    if (element.closest(".unseen")) continue;
    if (rect.width < 1 || rect.height < 1) { if (control || text) faults.push(`no size: ${name(element)}`); continue; }
    if ((element instanceof HTMLInputElement && !["checkbox", "range", "radio"].includes(element.type)) || element instanceof HTMLSelectElement) {
      if (needed(element) > rect.width + 1) faults.push(`cut: ${name(element)}, ${Math.round(rect.width)} of ${Math.round(needed(element))} px`);
    } else if (text && style.overflowX !== "visible" && element.scrollWidth > element.clientWidth + 1 && !/auto|scroll/.test(style.overflowX) && !(style.textOverflow === "ellipsis" && (element.title || element.closest("[title]"))))
      faults.push(`cut: ${name(element)}, ${element.clientWidth} of ${element.scrollWidth} px`);
    else if (control && element.scrollWidth > element.clientWidth + 1 && element.clientWidth > 0 && element.tagName === "BUTTON")
      faults.push(`cut: ${name(element)}, ${element.clientWidth} of ${element.scrollWidth} px`);
    let range = null;
    if (text && !(element instanceof HTMLSelectElement)) { range = document.createRange(); range.selectNodeContents(element); rect = range.getBoundingClientRect(); }
    let fixed = style.position === "fixed", scrolls = [false, false];
    let box = { left: rect.left, right: rect.right, top: rect.top, bottom: rect.bottom };
    for (let up = element.parentElement; up && !fixed; up = up.parentElement) {
      const look = getComputedStyle(up), edge = up.getBoundingClientRect();
      if (up === document.documentElement || up === document.body) break;
      for (const [axis, low, high, overflow] of [[0, "left", "right", look.overflowX], [1, "top", "bottom", look.overflowY]]) {
        if (scrolls[axis]) continue;
        if (/auto|scroll/.test(overflow)) { scrolls[axis] = true; continue; }
        if (overflow === "visible") continue;
        if (look.textOverflow === "ellipsis" && up.title && axis === 0) { scrolls[0] = true; continue; }
        if (box[low] < edge[low] - 1.5 || box[high] > edge[high] + 1.5)
          faults.push(`${axis ? "below" : "beside"}: ${name(element)} goes beyond ${up.id ? "#" + up.id : up.className || up.tagName}, ${Math.round(box[low])} to ${Math.round(box[high])} of ${Math.round(edge[low])} to ${Math.round(edge[high])} px`);
      }
      fixed = look.position === "fixed";
    }
    const pageScrolls = !/hidden|clip/.test(getComputedStyle(document.body).overflowY + getComputedStyle(document.documentElement).overflowY);
    if (!scrolls[0] && (box.left < -1.5 || box.right > innerWidth + 1.5)) faults.push(`off the screen: ${name(element)}, ${Math.round(box.left)} to ${Math.round(box.right)} of ${innerWidth} px`);
    if (!scrolls[1] && !pageScrolls && (box.top < -1.5 || box.bottom > innerHeight + 1.5)) faults.push(`off the screen: ${name(element)}, ${Math.round(box.top)} to ${Math.round(box.bottom)} of ${innerHeight} px high`);
    if (control && !element.disabled) {
      const frame = element.getBoundingClientRect();
      const at = [frame.left + frame.width / 2, frame.top + frame.height / 2];
      const over = document.elementFromPoint(...at);
      if (over && !element.contains(over) && !over.contains(element) && !(scrolls[0] || scrolls[1])) faults.push(`covered: ${name(element)} by ${name(over)}`);
    }
  }
  return [...new Set(faults)];
}
