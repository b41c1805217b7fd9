// The legend: a letter for each robot, which tells it from the others where colours do not.

// The first letter of each name; if two names begin alike, numbers from 1.
function robotLetters(robots) {
  const letters = robots.map(({ name }) => name.charAt(0).toUpperCase());
  return new Set(letters).size === letters.length ? letters : robots.map((_, i) => String(i + 1));
}

// The robot's letter in its colour.
function robotMark(robot, letter) {
  const mark = document.createElement("span");
  mark.className = "dot";
  mark.style.background = robot.color;
  mark.textContent = letter;
  return mark;
}

// A table row that begins with the robot's letter in its colour and its name, and has `cells` more cells.
function robotRow(robot, letter, cells) {
  const row = document.createElement("tr"), name = document.createElement("th");
  name.scope = "row";
  name.append(robotMark(robot, letter), robot.name);
  row.append(name);
  for (let i = 0; i < cells; i++) row.append(document.createElement("td"));
  return row;
}
