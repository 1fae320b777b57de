// SPDX-License-Identifier: Apache-2.0
// Starts what the page consists of, and leads from tables to moments.

function startLinks() {
  for (const button of document.querySelectorAll('[data-time]')) {
    button.addEventListener('click', () => {
      player.play(false);
      player.go(Number(button.dataset.time));
    });
  }
  for (const row of document.querySelectorAll('tr[data-begin]')) {
    row.addEventListener('click', () => {
      const begin = Number(row.dataset.begin);
      const end = Number(row.dataset.end);
      const aside = 0.05 * (end - begin);
      player.play(false);
      zoomTo(begin - aside, end + aside);
      player.go(begin);
    });
  }
}

startPlayer();
startScene();
startPlots();
startLinks();
player.go(0);
