// A flight that goes on: the server sends what there is, then row by row what comes.

/** Listens until the command ends; `start` makes the viewer of the first flight. */
export function listen(start) {
  const state = document.getElementById('state')
  const source = new EventSource('events')
  let viewer
  source.addEventListener('flight', ({ data }) => {
    const recordings = [JSON.parse(data)]
    if (viewer) {
      viewer.begin(recordings)
    } else {
      viewer = start(recordings)
    }
    viewer.following = true
    viewer.live = true
    viewer.play(true)
    state.textContent = 'live'
  })
  source.addEventListener('message', ({ data }) => viewer?.flights[0].push(JSON.parse(data)))
  source.addEventListener('error', () => (state.textContent = 'the command has ended'))
  state.addEventListener('click', () => {
    if (!viewer) return
    viewer.live = true
    viewer.play(true)
  })
}
