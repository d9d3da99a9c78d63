//! The language of the files in `shapes`: drawn numbers, formulas and commands that build a body.
//!
//! A line assigns a name (`top = 0.4 * height`) or is a command with arguments and an optional
//! block (`repeat k, 4 { … }`). A text in quotation marks is 1 if it is the drawn form, else 0.
//! `draw(0.01, 0.03)`, `count(3, 6)` and `chance(0.4)` draw numbers in order of appearance. Lengths
//! are in metres, angles in radians.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use super::draw::Draw;
use gripcast_base::error::{Error, Result};

/// A formula.
#[derive(Debug)]
pub(super) enum Formula {
    Number(f64),
    Name(&'static str),
    /// A form: a text in quotation marks.
    Form(&'static str),
    Call(&'static str, Vec<Formula>),
}

/// A statement with its block.
#[derive(Debug, Default)]
pub(super) struct Step {
    /// Command; `=` for an assignment.
    pub(super) command: &'static str,
    pub(super) arguments: Vec<Formula>,
    pub(super) block: Vec<Step>,
    otherwise: Vec<Step>,
}

/// Binary operators, lowest precedence first.
const OPERATORS: [&[&str]; 5] = [
    &["or"],
    &["and"],
    &["<", ">", "<=", ">="],
    &["+", "-"],
    &["*", "/"],
];

/// Parses a text into steps.
///
/// # Errors
/// `Internal` with the line of a syntax error.
pub(super) fn parse(text: &'static str) -> Result<Vec<Step>> {
    let mut parser = Parser {
        tokens: tokens(text),
        at: 0,
        is_open: false,
    };
    let steps = parser.steps();
    if parser.peek().is_none() && !parser.is_open {
        return Ok(steps);
    }
    let parsed = &parser.tokens[..parser.at];
    let line = 1 + parsed.iter().filter(|t| **t == "\n").count();
    let found = parser.peek().unwrap_or("the end");
    Err(Error::internal(format!(
        "syntax error in line {line} of a shape at {found:?}"
    )))
}

/// Returns the arguments of a top-level command.
pub(super) fn header(text: &'static str, command: &str) -> Vec<Formula> {
    let steps = parse(text).unwrap_or_default();
    let found = steps.into_iter().find(|step| step.command == command);
    found.map(|step| step.arguments).unwrap_or_default()
}

/// Splits a text into words, numbers, texts with their opening quotation mark, operators and line
/// ends.
fn tokens(text: &'static str) -> Vec<&'static str> {
    let mut tokens = Vec::new();
    for line in text.lines() {
        let mut rest = line.split('#').next().unwrap_or_default().trim();
        while let Some(first) = rest.chars().next() {
            let is_word = |c: char| c.is_alphanumeric() || c == '_' || c == '.';
            let length = match first {
                '"' => rest[1..].find('"').map_or(rest.len(), |end| end + 1),
                c if is_word(c) => rest.find(|c| !is_word(c)).unwrap_or(rest.len()),
                '<' | '>' if rest[1..].starts_with('=') => 2,
                c => c.len_utf8(),
            };
            tokens.push(&rest[..length]);
            rest = &rest[length..];
            if first == '"' {
                rest = rest.strip_prefix('"').unwrap_or(rest);
            }
            rest = rest.trim_start();
        }
        tokens.push("\n");
    }
    tokens
}

struct Parser {
    tokens: Vec<&'static str>,
    at: usize,
    /// Whether a block is not closed.
    is_open: bool,
}

impl Parser {
    fn peek(&self) -> Option<&'static str> {
        self.tokens.get(self.at).copied()
    }

    fn accept(&mut self, token: &str) -> bool {
        let found = self.peek() == Some(token);
        self.at += usize::from(found);
        found
    }

    /// Consumes a word, if there is one.
    fn word(&mut self) -> Option<&'static str> {
        let word = self.peek().filter(|t| t.starts_with(char::is_alphabetic))?;
        self.at += 1;
        Some(word)
    }

    /// Parses steps up to the first other token.
    fn steps(&mut self) -> Vec<Step> {
        let mut steps = Vec::new();
        loop {
            while self.accept("\n") {}
            match self.step() {
                Some(step) => steps.push(step),
                None => return steps,
            }
        }
    }

    fn step(&mut self) -> Option<Step> {
        let word = self.word()?;
        if self.accept("=") {
            return Some(Step {
                command: "=",
                arguments: vec![Formula::Name(word), self.formula(0)?],
                ..Step::default()
            });
        }
        let mut step = Step {
            command: word,
            ..Step::default()
        };
        while !matches!(self.peek(), None | Some("\n" | "{" | "}")) {
            step.arguments.push(self.formula(0)?);
            self.accept(",");
        }
        if self.accept("{") {
            step.block = self.block()?;
        }
        if self.accept("else") {
            step.otherwise = if self.accept("{") {
                self.block()?
            } else {
                vec![self.step()?]
            };
        }
        Some(step)
    }

    fn block(&mut self) -> Option<Vec<Step>> {
        let steps = self.steps();
        let is_closed = self.accept("}");
        self.is_open |= !is_closed;
        is_closed.then_some(steps)
    }

    fn formula(&mut self, level: usize) -> Option<Formula> {
        let Some(operators) = OPERATORS.get(level) else {
            return self.operand();
        };
        let mut left = self.formula(level + 1)?;
        while let Some(operator) = self.peek().filter(|t| operators.contains(t)) {
            self.at += 1;
            left = Formula::Call(operator, vec![left, self.formula(level + 1)?]);
        }
        Some(left)
    }

    fn operand(&mut self) -> Option<Formula> {
        if self.accept("-") {
            return Some(Formula::Call("negative", vec![self.operand()?]));
        }
        if self.accept("(") {
            let inner = self.formula(0)?;
            return self.accept(")").then_some(inner);
        }
        if let Some(word) = self.word() {
            if !self.accept("(") {
                return Some(Formula::Name(word));
            }
            let mut arguments = Vec::new();
            while !self.accept(")") {
                arguments.push(self.formula(0)?);
                self.accept(",");
            }
            return Some(Formula::Call(word, arguments));
        }
        let token = self.peek()?;
        let operand = match token.strip_prefix('"') {
            Some(form) => Formula::Form(form),
            None => Formula::Number(token.parse().ok()?),
        };
        self.at += 1;
        Some(operand)
    }
}

/// Variables while steps are executed.
pub(super) struct Scope<'a> {
    names: HashMap<&'static str, f64>,
    form: &'static str,
    draw: Option<&'a mut Draw>,
}

impl<'a> Scope<'a> {
    pub(super) fn new(draw: &'a mut Draw) -> Self {
        Self {
            names: HashMap::from([("pi", PI), ("tau", TAU)]),
            form: "",
            draw: Some(draw),
        }
    }

    /// Draws one of the forms.
    pub(super) fn draw_form(&mut self, forms: &[Formula]) {
        let names = forms.iter().filter_map(|form| match form {
            Formula::Form(name) => Some(*name),
            _ => None,
        });
        if let Some(draw) = &mut self.draw {
            self.form = draw.form(&names.collect::<Vec<_>>());
        }
    }

    /// Returns a copy with more variables, which cannot draw numbers.
    pub(super) fn with<const N: usize>(&self, more: [(&'static str, f64); N]) -> Scope<'static> {
        let mut names = self.names.clone();
        names.extend(more);
        Scope {
            names,
            form: self.form,
            draw: None,
        }
    }

    pub(super) fn get(&self, name: &str) -> f64 {
        self.names.get(name).copied().unwrap_or(f64::NAN)
    }

    pub(super) fn set(&mut self, name: &'static str, value: f64) {
        self.names.insert(name, value);
    }

    /// Evaluates the arguments of a step.
    pub(super) fn arguments(&mut self, step: &Step) -> Vec<f64> {
        step.arguments.iter().map(|f| self.evaluate(f)).collect()
    }

    /// Evaluates a formula; NaN for an unknown name or function.
    pub(super) fn evaluate(&mut self, formula: &Formula) -> f64 {
        let (function, arguments) = match formula {
            Formula::Number(value) => return *value,
            Formula::Name(name) => return self.get(name),
            Formula::Form(form) => return truth(*form == self.form),
            Formula::Call(function, arguments) => (*function, arguments),
        };
        let values: Vec<f64> = arguments.iter().map(|f| self.evaluate(f)).collect();
        if let Some(draw) = &mut self.draw {
            match (function, &values[..]) {
                ("draw", [low, high]) => return draw.between(*low, *high),
                ("count", [low, high]) => {
                    return draw.count(*low as usize, *high as usize) as f64;
                }
                ("chance", [probability]) => return truth(draw.chance(*probability)),
                _ => {}
            }
        }
        match values[..] {
            [x] => unary(function, x),
            [x, y] => binary(function, x, y),
            [x, low, high] if function == "clamp" => x.max(low).min(high),
            [condition, yes, no] if function == "if" => {
                if condition > 0.0 {
                    yes
                } else {
                    no
                }
            }
            _ => f64::NAN,
        }
    }

    /// Executes steps; other commands are passed to `act`, whose first result ends the execution.
    pub(super) fn run<'s, T>(
        &mut self,
        steps: &'s [Step],
        act: &mut impl FnMut(&mut Self, &'s Step) -> Option<T>,
    ) -> Option<T> {
        steps
            .iter()
            .find_map(|step| match (step.command, &step.arguments[..]) {
                ("=", [Formula::Name(name), formula]) => {
                    let value = self.evaluate(formula);
                    self.set(name, value);
                    None
                }
                ("if", [condition]) => {
                    let holds = self.evaluate(condition) > 0.0;
                    self.run(if holds { &step.block } else { &step.otherwise }, act)
                }
                ("repeat", [Formula::Name(name), times]) => {
                    let times = self.evaluate(times) as usize;
                    (0..times).find_map(|k| {
                        self.set(name, k as f64);
                        self.run(&step.block, act)
                    })
                }
                _ => act(self, step),
            })
    }
}

fn truth(holds: bool) -> f64 {
    f64::from(u8::from(holds))
}

fn unary(function: &str, x: f64) -> f64 {
    match function {
        "negative" => -x,
        "not" => truth(x <= 0.0),
        "abs" => x.abs(),
        "sin" => x.sin(),
        "cos" => x.cos(),
        "asin" => x.asin(),
        "sqrt" => x.sqrt(),
        "ceil" => x.ceil(),
        "smoothstep" => super::shape::smoothstep(x),
        _ => f64::NAN,
    }
}

fn binary(function: &str, x: f64, y: f64) -> f64 {
    match function {
        "+" => x + y,
        "-" => x - y,
        "*" => x * y,
        "/" => x / y,
        "<" => truth(x < y),
        ">" => truth(x > y),
        "<=" => truth(x <= y),
        ">=" => truth(x >= y),
        "and" => truth(x > 0.0 && y > 0.0),
        "or" => truth(x > 0.0 || y > 0.0),
        "min" => x.min(y),
        "max" => x.max(y),
        "power" => x.powi(y as i32),
        "real_power" => x.powf(y),
        _ => f64::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::random::SeedStream;

    #[test]
    fn steps_are_executed_and_formulas_evaluated() {
        let text = "a = 7 - 2 - 1 # comment\nb = -a * (1 + 2) / 4\nrepeat k, 3 { c = k }\n\
                    if a > 3 and not(\"ring\") { d = if(b < 0, 1, 2) } else { d = 3 }\nstop d, 5";
        let steps = parse(text).unwrap();
        let mut draw = Draw(SeedStream::named(1, "script"));
        let mut scope = Scope::new(&mut draw);
        let found = scope.run(&steps, &mut |scope, step| {
            (step.command == "stop").then(|| scope.arguments(step))
        });
        assert_eq!(found.unwrap(), [1.0, 5.0]);
        assert_eq!(
            [scope.get("a"), scope.get("b"), scope.get("c")],
            [4.0, -3.0, 2.0]
        );
        assert!(scope.get("e").is_nan());
    }

    #[test]
    fn syntax_errors_name_the_line() {
        for text in [
            "a = 1\nb = ",
            "a = 1\nlathe {",
            "a = 1\nb = (2 + 3",
            "a = 1\n}",
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(
                error.contains("line 2") || error.contains("the end"),
                "{text}: {error}"
            );
        }
    }
}
